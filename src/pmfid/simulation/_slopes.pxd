"""Derivatives of a servo's motion by its parameters and its start, carried from tick to tick.

They are exact. At an event the velocity is zero, so the time of an event moves the position only after the event.
"""

from libc.math cimport exp, fabs

from pmfid.simulation._body cimport Parameters, State, advance, ramp_factor, time_to_stop


cdef enum:
    WIDTH = 18  # most columns: 15 parameters, start position and start velocity, and one for an even number


cdef struct Servo:
    double inertia, viscous, coulomb, kp, kd, torque_limit, delay, loop_delay, gravity, gravity_angle, offset
    double stribeck, stribeck_speed, load_friction, quadratic


cdef struct Columns:
    # The column of each parameter, -1 for none.
    Py_ssize_t inertia, viscous, coulomb, kp, kd, torque_limit, delay, loop_delay, gravity, gravity_angle, offset
    Py_ssize_t stribeck, stribeck_speed, load_friction, quadratic


cdef struct Slopes:
    # Derivatives by column: of the position, the velocity, the position in the loop and the one at the tick before.
    double x[WIDTH]
    double v[WIDTH]
    double y[WIDTH]
    double before[WIDTH]
    # Scratch: of the force without friction, the friction, the net force and the damping.
    double force[WIDTH]
    double friction[WIDTH]
    double net[WIDTH]
    double damping[WIDTH]
    Py_ssize_t width  # columns in use, an even number


cdef struct Drive:
    # The mean torque over a tick; its derivatives by kp at position 0, by the limit and by the start; the part of the
    # tick without a limit.
    double torque, gain, most, start, free


cdef struct Curve:
    # Of the motion without an event for one z = viscous h / mass: what is left of the velocity, its mean, the way of an
    # acceleration, and the derivatives of the last two by z.
    double z, left, mean, ramp, by_mean, by_ramp


cdef struct Tick:
    # What acts from a velocity v on: position y in the loop and its change w, torque + load, and parts of both.
    double h, v, y, w, force, friction, sum, sine, cosine, exponential
    Drive drive


cdef inline Curve find_curve(double z) noexcept nogil:
    cdef double left = exp(-z), ramp = ramp_factor(z), mean = 1.0 - z * ramp, by_mean
    if z > 0.02:
        by_mean = (left - mean) / z
        return Curve(z, left, mean, ramp, by_mean, (-by_mean - ramp) / z)
    # The closed forms lose digits for small z. The series leave out parts of 1e-9.
    return Curve(z, left, mean, ramp, -1.0 / 2 + z * (1.0 / 3 - z * (1.0 / 8 - z * (1.0 / 30 - z / 144))),
                 -1.0 / 6 + z * (1.0 / 12 - z * (1.0 / 40 - z * (1.0 / 180 - z / 1008))))


cdef inline void carry_piece(Slopes *d, double v, double net, double h, Parameters p, Py_ssize_t mass,
                             Curve *curve) noexcept nogil:
    """Carry the derivatives through the time h under p.mass v' = net - p.viscous v, without an event inside."""
    cdef double share = h / p.mass, z = p.viscous * share, way = net * share, xv, xn, vn, xz, vz
    cdef Py_ssize_t k
    if curve.z != z:
        curve[0] = find_curve(z)
    xv, xn, vn = h * curve.mean, h * curve.ramp * share, curve.mean * share
    xz = (curve.by_mean * v + curve.by_ramp * way) * h * share
    vz = (curve.by_mean * way - curve.left * v) * share
    for k in range(d.width):
        d.x[k] += xv * d.v[k] + xn * d.net[k] + xz * d.damping[k]
        d.v[k] = curve.left * d.v[k] + vn * d.net[k] + vz * d.damping[k]
    if mass >= 0:
        d.x[mass] -= (xn * net + xz * p.viscous) / p.mass
        d.v[mass] -= (vn * net + vz * p.viscous) / p.mass


cdef inline void carry_on(Slopes *d, double toward, double fall, double net, double h, Parameters p,
                          Py_ssize_t mass, Curve *curve) noexcept nogil:
    """Carry the derivatives on for the time h under `net`, after a stop at which the acceleration was `fall`."""
    cdef State end = State(0.0, 0.0, 0.0, 0.0)
    cdef double late[WIDTH]
    cdef Py_ssize_t k
    for k in range(d.width):
        late[k] = -d.v[k] / fall
        d.v[k] = 0.0
        d.net[k] += 2.0 * toward * d.friction[k]
    carry_piece(d, 0.0, net, h, p, mass, curve)
    advance(&end, net, h, Parameters(p.mass, p.viscous, 0.0))
    for k in range(d.width):
        d.x[k] -= end.v * late[k]
        d.v[k] -= (net - p.viscous * end.v) / p.mass * late[k]


cdef inline void push(Slopes *d, Py_ssize_t column, double change) noexcept nogil:
    """Add the derivative of the torque by a parameter."""
    if column >= 0:
        d.force[column] += change
        d.friction[column] += change


cdef inline void pull(Slopes *d, Py_ssize_t column, double change) noexcept nogil:
    """Add the derivative of the load by a parameter."""
    if column >= 0:
        d.force[column] -= change
        d.friction[column] += change


cdef inline void add(double *slope, Py_ssize_t column, double change) noexcept nogil:
    if column >= 0:
        slope[column] += change


cdef inline void differentiate(Slopes *d, const Tick *now, Servo p, const Columns *at) noexcept nogil:
    """Write the derivatives of the force, the friction and the damping."""
    cdef double side = 1.0 if now.v > 0.0 else (-1.0 if now.v < 0.0 else 0.0), torque, load
    cdef double share = p.load_friction if now.sum > 0.0 else -p.load_friction, free = now.drive.free
    cdef double by_before = free * p.kd / now.h, by_y = -free * p.kp - by_before, bend = 0.0
    cdef Py_ssize_t k
    for k in range(d.width):
        torque = by_y * d.y[k] + by_before * d.before[k]
        load = now.cosine * (d.x[k] + 0.5 * now.h * d.v[k])
        d.before[k] = d.y[k]
        d.force[k] = torque - load
        d.friction[k] = torque + load
        d.damping[k] = p.quadratic * side * d.v[k]
    push(d, at.kp, now.drive.gain - free * now.y)
    push(d, at.kd, -free * now.w)
    push(d, at.torque_limit, now.drive.most)
    push(d, at.delay, -now.drive.start)
    pull(d, at.gravity, now.sine)
    pull(d, at.gravity_angle, -now.cosine)
    pull(d, at.offset, 1.0)
    if p.stribeck != 0.0:
        bend = p.stribeck / p.stribeck_speed * now.exponential
    for k in range(d.width):
        d.friction[k] = share * d.friction[k] - bend * side * d.v[k]
    add(d.friction, at.coulomb, 1.0)
    add(d.friction, at.stribeck, now.exponential)
    add(d.friction, at.stribeck_speed, bend * fabs(now.v) / p.stribeck_speed)
    add(d.friction, at.load_friction, fabs(now.sum))
    add(d.damping, at.viscous, 1.0)
    add(d.damping, at.quadratic, fabs(now.v))


cdef inline void carry(Slopes *d, const Tick *now, Servo p, const Columns *at, Curve *curve) noexcept nogil:
    """Carry the derivatives through a tick. `curve` is that of the tick before."""
    cdef double toward = 1.0 if now.v > 0.0 or (now.v == 0.0 and now.force > 0.0) else -1.0
    cdef double net = now.force - toward * now.friction, stop = now.h
    cdef bint sticks = fabs(now.force) <= now.friction
    cdef Parameters body = Parameters(p.inertia, p.viscous + p.quadratic * fabs(now.v), now.friction)
    cdef Curve first = Curve(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cdef Py_ssize_t k
    differentiate(d, now, p, at)
    if now.v != 0.0 or not sticks:
        # A time to the stop is at least mass |v| / (brake + viscous |v|).
        if p.inertia * fabs(now.v) < now.h * (body.viscous * fabs(now.v) - toward * net) and toward * net < 0.0:
            stop = time_to_stop(fabs(now.v), -toward * net, body)
        for k in range(d.width):
            d.net[k] = d.force[k] - toward * d.friction[k]
        if stop >= now.h:
            carry_piece(d, now.v, net, now.h, body, at.inertia, curve)
            return
        carry_piece(d, now.v, net, stop, body, at.inertia, &first)
        if not sticks:
            carry_on(d, toward, net / p.inertia, now.force + toward * now.friction, now.h - stop, body,
                     at.inertia, &first)
            return
    for k in range(d.width):
        d.v[k] = 0.0
