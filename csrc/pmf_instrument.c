/* The recursion with instruments from the auxiliary model, and its choice between two estimates.
 * SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

/* Status bits of the instrumental recursion that remain with the estimate of the simpler method. */
static const uint32_t KEPT_ON_FALLBACK = ((uint32_t)(PMF_RESET | PMF_UNMODELLED | PMF_FEEDBACK));

PMF_API void pmf_instrument_restart(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
    state->auxiliary.velocity = PMF_R(0.0);
    state->auxiliary.position = PMF_R(0.0);
}

PMF_API uint32_t pmf_instrument_parameters(const pmf_config_t *config)
{
    return config->instrument.n_parameters;
}

/* The nodes that the auxiliary model writes. */
typedef struct {
    real_t signal[PMF_SIGNALS];
} signals_t;

/* Lanes without parameters keep only the model and its signals: a copy of the whole state takes as long as several
 * samples. */
PMF_API void pmf_instrument_simulate(const pmf_config_t *config, pmf_state_t *state)
{
    truth_t running = state->auxiliary.running != 0U;
    signals_t *signals = (signals_t *)(void *)state->network.node;
#if PMF_STEPS
    if (config->auxiliary.steps != 0U) {
        state->auxiliary.step = config->auxiliary.dt * state->encoder.ratio_before;
    }
#endif
#if PMF_LATE
    if (config->late.kept != 0U && running != 0) {
        pmf_auxiliary_late_step(&config->auxiliary, &state->auxiliary, &state->late, state->network.node);
        return;
    }
#endif
    PMF_WHERE(running, &state->auxiliary,
              PMF_WHERE(running, signals, pmf_auxiliary_step(&config->auxiliary, &state->auxiliary, signals->signal)));
}

PMF_API void pmf_instrument_correct(const pmf_config_t *config, pmf_state_t *state, truth_t looks)
{
    pmf_fading_t *fading = &state->auxiliary.fading;
    pmf_clear_traces(looks, (real_t *)(void *)fading, (uint32_t)(sizeof *fading / sizeof(real_t)));
    pmf_auxiliary_correct(&config->auxiliary, &state->auxiliary, config->instrument.first_column,
                          state->network.column);
}

PMF_API void pmf_instrument_settle(const pmf_config_t *config, pmf_state_t *state, truth_t settling)
{
    truth_t half_way = settling & (state->settle == config->settle_samples / 2U);
    state->auxiliary.velocity =
        PMF_IF(half_way, state->network.column[config->auxiliary.check_column], state->auxiliary.velocity);
    state->auxiliary.position = PMF_IF(half_way, state->network.node[PMF_LATE_POSITION], state->auxiliary.position);
}

/* Average the parameters with which the model made the samples of the sums. */
static void note_model(const pmf_config_t *config, pmf_state_t *state, truth_t where)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    const real_t *theta = state->instrument.estimate.theta;
    real_t used[PMF_MAX_PARAMETERS], share = PMF_R(1.0) / state->instrument.sums.weight;
    uint32_t i;
    for (i = 0; i < PARAMETERS(&config->instrument); ++i) {
        used[i] = theta[i];
    }
    for (i = 0; i < PMF_ROLES; ++i) {
        if (auxiliary->index[i] != PMF_NO_PARAMETER) {
            used[auxiliary->index[i]] = state->auxiliary.parameter[i];
        }
    }
    for (i = 0; i < PARAMETERS(&config->instrument); ++i) {
        state->model[i] = PMF_IF(where, state->model[i] + share * (used[i] - state->model[i]), state->model[i]);
    }
}

/* Write the instrumental estimate. The sums hold samples of a model with other parameters, and such a sample moves the
 * estimate by less than the model is off. */
static void show_estimate(uint32_t p, pmf_state_t *state)
{
    const pmf_estimate_t *own = &state->instrument.estimate;
    pmf_estimate_t *output = &state->output;
    uint32_t i;
    for (i = 0; i < p; ++i) {
        real_t apart = own->theta[i] - state->model[i];
        real_t error = apart * apart / (own->variance_factor[i] * own->innovation_variance);
        output->theta[i] = own->theta[i];
        output->variance_factor[i] = own->variance_factor[i];
        output->inflation[i] = own->inflation[i] + PMF_IF(error - error == PMF_R(0.0), error, PMF_R(0.0));
    }
    output->innovation = own->innovation;
    output->innovation_variance = own->innovation_variance;
}

/* Write the direct estimate in the parameters of the instrumental estimate. */
static void borrow_estimate(const pmf_config_t *config, const pmf_estimate_t *direct, pmf_state_t *state)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    pmf_estimate_t *borrowed = &state->output;
    uint32_t i;
    for (i = 0; i < PMF_ROLES; ++i) {
        uint32_t own = auxiliary->index[i], other = auxiliary->direct_index[i];
        if (own != PMF_NO_PARAMETER && other != PMF_NO_PARAMETER) {
            borrowed->theta[own] = direct->theta[other];
            borrowed->variance_factor[own] = direct->variance_factor[other];
            borrowed->inflation[own] = direct->inflation[other];
        }
        if (own != PMF_NO_PARAMETER && other == PMF_NO_PARAMETER && i >= PMF_BODY_ROLES) { /* a shape of its own */
            borrowed->variance_factor[own] = PMF_UNKNOWN;
        }
    }
    borrowed->innovation = direct->innovation;
    borrowed->innovation_variance = direct->innovation_variance;
}

#if PMF_STEPS
/* A sum over samples becomes an integral over time. Each row, one sample late, has half the weight of its two
 * neighbouring steps. Otherwise the samples of a burst would have all weight, and the pause none. */
static void weigh_instruments(const pmf_recursion_config_t *config, pmf_network_state_t *network)
{
    real_t longest = (real_t)PMF_LONGEST, *zeta = &network->column[config->first_column + config->n_parameters + 1U];
    real_t weight = PMF_R(0.5) * ((network->ratio < longest ? network->ratio : longest) +
                                  (network->ratio_before < longest ? network->ratio_before : longest));
    uint32_t i;
    for (i = 0; i < config->n_parameters; ++i) {
        zeta[i] *= weight;
    }
}
#endif

/* The instrumental estimate takes over after a fair fraction of the direct estimate's samples. The instrumental
 * estimate must also know the mass about as well as the direct estimate, or well enough. */
static truth_t takes_over(const pmf_config_t *config, const pmf_state_t *state)
{
    static const scalar_t TAKE_OVER = PMF_SCALAR(3.0); /* ratio of samples, or of variances */
    static const scalar_t SHORT_BAR = PMF_SCALAR(0.01); /* fraction of the mass as a small standard error */
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    uint32_t mass = config->auxiliary.index[PMF_MASS], direct_mass = config->auxiliary.direct_index[PMF_MASS];
    real_t small = SHORT_BAR * own->theta[mass];
    /* samples weighted by a power of their number count less */
    real_t power = PMF_ALIKE((scalar_t)config->instrument.growing);
    real_t gathered = PMF_R(0.5) * (PMF_R(1.0) + power) * state->instrument.sums.weight;
    truth_t enough = TAKE_OVER * gathered > state->direct.sums.weight;
    enough = enough & ((own->variance_factor[mass] < TAKE_OVER * direct->variance_factor[direct_mass]) |
                       (own->variance_factor[mass] * own->inflation[mass] * own->innovation_variance < small * small));
    return (state->instrument.started > 0U) & ((state->direct.started == 0U) | enough);
}

/* Forget the early residuals of the instrumental estimate, which are not noise. Without forgetting these residuals
 * would stay in the error bars. They may be orders of magnitude larger than the direct residuals. */
static void forget_start(pmf_state_t *state, truth_t where)
{
    real_t limit = state->instrument.weight * state->direct.estimate.innovation_variance;
    where = where & (limit > PMF_R(0.0)) & (state->instrument.innovation_square > limit);
    state->instrument.innovation_square = PMF_IF(where, limit, state->instrument.innovation_square);
}

PMF_API whole_t pmf_instrument_step(const pmf_config_t *config, pmf_state_t *state, whole_t direct_status,
                                    truth_t settled)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    truth_t held = state->hold != 0U; /* the measured velocity does not show the axis */
    truth_t trusted = pmf_auxiliary_check(auxiliary, &state->auxiliary, state->network.column, held), in_charge,
            borrows, due;
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    whole_t status, stepped = PMF_W(0);
    /* sums with a wrong direction would stay */
    PMF_WHERE(PMF_NOT(trusted) & (state->instrument.updates != 0U), &state->instrument,
              pmf_clear(&state->instrument, (uint32_t)sizeof state->instrument));
    status = PMF_BIT(PMF_NOT(trusted) | (state->instrument.started == 0U), PMF_STARTING);
    /* half-way between two direct solutions, so that no sample has two */
    due = (state->samples & (config->instrument.every - 1U)) == config->instrument.every / 2U;
#if PMF_STEPS
    if (PMF_SPACED(config)) {
        weigh_instruments(&config->instrument, &state->network);
    }
#endif
    PMF_WHERE(trusted & settled, &state->instrument,
              stepped = pmf_recursion_step(&config->instrument, &state->instrument, state->network.column, due));
    status = PMF_IF(trusted & settled, stepped, status);
    note_model(config, state, trusted & settled & (state->instrument.sums.weight > PMF_R(0.0)));
    status |= pmf_auxiliary_feedback(&state->auxiliary, state->network.node, trusted & settled,
                                     state->encoder.input - state->encoder.input_before);
    status |= pmf_auxiliary_late(auxiliary, &state->auxiliary, state->network.column,
                                 trusted & settled & (state->auxiliary.in_charge != 0U));
    in_charge = trusted & (state->auxiliary.in_charge != 0U);
    if (PMF_ANY(trusted & PMF_NOT(in_charge))) {
        in_charge = in_charge | (trusted & takes_over(config, state));
        forget_start(state, in_charge & (state->auxiliary.in_charge == 0U));
    }
    state->auxiliary.in_charge = PMF_BIT(in_charge, 1U);
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, in_charge, own->theta, auxiliary->index);
    PMF_WHERE(in_charge, &state->output, show_estimate(PARAMETERS(&config->instrument), state));
    if (PMF_ALL(in_charge)) {
        return status;
    }
    borrows = PMF_NOT(in_charge) & (state->direct.started != 0U) & ((direct_status & PMF_POOR_EXCITATION) == 0U);
    if (auxiliary->has_initial != 0U) {
        borrows = borrows & PMF_NOT(trusted);
    }
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, borrows, direct->theta, auxiliary->direct_index);
    PMF_WHERE(PMF_NOT(in_charge), &state->output, borrow_estimate(config, direct, state));
    direct_status = (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK;
    return PMF_IF(in_charge, status, direct_status | (status & KEPT_ON_FALLBACK));
}

#if PMF_WHOLE /* for one axis */
const pmf_estimate_t *pmf_instrument_estimate(const pmf_state_t *state)
{
    return &state->output;
}

void pmf_instrument_covariance(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    uint32_t n = config->instrument.n_parameters, i;
    if ((state->status & PMF_FALLBACK) == 0U) {
        pmf_recursion_covariance(&config->instrument, &state->instrument, p);
        return;
    }
    for (i = 0; i < n * n; ++i) {
        p[i] = i % (n + 1U) == 0U ? state->output.variance_factor[i / (n + 1U)] : PMF_R(0.0);
    }
}

void pmf_instrument_gap(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state->auxiliary.fading.jump, (uint32_t)sizeof state->auxiliary.fading.jump);
    state->auxiliary.fading.mismatch = PMF_R(0.0);
    state->auxiliary.fading.power *=
        PMF_R(10.0); /* a larger error of the model's velocity, over its power, resets the velocity */
    state->auxiliary.trial = config->auxiliary.trial_samples;
}

uint32_t pmf_instrument_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root)
{
    uint32_t role;
    pmf_recursion_open(&config->instrument, &state->instrument, parameter, root);
    for (role = 0; role < PMF_ROLES; ++role) {
        if (parameter != PMF_NO_PARAMETER && config->auxiliary.index[role] == parameter) {
            return config->auxiliary.direct_index[role];
        }
    }
    return PMF_NO_PARAMETER;
}
#endif
