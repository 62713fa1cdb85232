"""
Predict a record that the model has not seen
============================================

The parameters come from a random input. They then predict a run under position control, from its input alone.
"""

import pmfid
from pmfid.simulation import CART, make_scenario

training = make_scenario("prbs", seed=1, increments=512)
unseen = make_scenario("moves", seed=2, increments=512)
result = pmfid.identify(
    training.motion.u,
    training.counts,
    model=pmfid.Drive(CART.input_gain),
    encoder=pmfid.Encoder(training.resolution),
    dt=training.dt,
    method="iv",
    cutoff=33.0,
)
validation = pmfid.validate(result, unseen.motion.u, unseen.counts)
print(validation)
figure = validation.plot()
