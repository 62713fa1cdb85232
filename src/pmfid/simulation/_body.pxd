"""The motion of a body with Coulomb friction, solved from event to event without an integration error."""

from libc.math cimport expm1, fabs, log1p


cdef struct Parameters:
    double mass, viscous, coulomb


cdef struct State:
    double x, v          # m, m/s
    double direction     # (time moving forward - time moving backward) / dt of the last interval
    double moving        # time moving / dt of the last interval


cdef inline double ramp_factor(double z) noexcept nogil:
    """Return (z - 1 + exp(-z)) / z**2 for 0 <= z."""
    cdef double total
    cdef int k
    if z > 0.5:
        return (z + expm1(-z)) / (z * z)
    # The closed form loses digits for small z (relative error 1e-16 / z). The first term that this series leaves
    # out is 0.5**14 / 16! = 3e-18.
    total = 1.0
    for k in range(15, 2, -1):
        total = 1.0 - z * total / k
    return 0.5 * total


cdef inline void glide(State *state, double push, double time, Parameters p) noexcept nogil:
    """Move for `time` under m v' = push - d v, without an event inside."""
    cdef double z = p.viscous / p.mass * time
    cdef double fall = expm1(-z)
    cdef double mean = -fall / z if z > 0.0 else 1.0
    cdef double acceleration = push / p.mass
    state.x += time * (mean * state.v + acceleration * time * ramp_factor(z))
    state.v += fall * state.v + acceleration * time * mean


cdef inline double time_to_stop(double speed, double brake, Parameters p) noexcept nogil:
    """Return the time until m v' = -brake - d v, v(0) = speed > 0, brake > 0, reaches v = 0."""
    cdef double q = p.viscous * speed / brake
    if q > 1.0:
        return p.mass / p.viscous * log1p(q)
    return p.mass * speed / brake * (log1p(q) / q if q > 0.0 else 1.0)


cdef inline void advance(State *state, double force, double dt, Parameters p) noexcept nogil:
    """Move for one interval with constant force.

    At most one event occurs, so the motion has at most two pieces. Let the cart move with sign `side`.
    (a) If side*force >= F_c, v tends to (force - side F_c)/d, which is zero or has the sign of v. The velocity does
    not cross zero, so no event occurs. A cart that breaks away from v = 0 has side*force > F_c and belongs here.
    (b) If side*force < F_c, v falls monotonically and crosses zero once. If |force| <= F_c, the cart then sticks for
    the rest of the interval, because the force is constant. If side*force < -F_c, the cart reverses; with -side for
    side this is case (a), so no further event occurs.
    """
    cdef double side, brake, first
    state.direction = 0.0
    state.moving = 0.0
    if state.v == 0.0 and fabs(force) <= p.coulomb:
        return
    side = 1.0 if state.v > 0.0 or (state.v == 0.0 and force > 0.0) else -1.0
    brake = p.coulomb - side * force
    first = time_to_stop(fabs(state.v), brake, p) if brake > 0.0 else dt
    state.moving = 1.0
    if first >= dt:
        glide(state, -side * brake, dt, p)
        # If the cart stops just at the end of the interval, rounding can carry the velocity past zero.
        if side * state.v < 0.0:
            state.v = 0.0
        state.direction = side
        return
    glide(state, -side * brake, first, p)
    state.v = 0.0
    if fabs(force) > p.coulomb:
        glide(state, force + side * p.coulomb, dt - first, p)
        state.direction = side * ((first - (dt - first)) / dt)
    else:
        state.moving = first / dt
        state.direction = side * state.moving
