/* One mass with friction: its motion under a held input or a controller, and the exact derivatives by every parameter.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 *   m v' = g - d v - e |v| - F sign(v) - c - sum_j a_j h_j(x, v, column_j),   lag g' = u(t - delay) - g
 *
 * With a controller, u is the goal, and the force of the motor is
 *
 *   clip(gain (g - y) - sum_j a_j h_j, -limit, limit)
 *
 * over the forces h_j of the loop. y is the position a loop delay ago, by an all-pass of the first order, so that
 * x - delay w is y for a velocity w with half of the delay as its time constant.
 *
 * Between switches of the input, stops and parts of an interval, the motion has a closed form. Forces h_j are held
 * within a part at their value in the middle of the part. A stop moves in time: the derivatives of the velocity scale
 * with the acceleration after and before the stop. */
#ifndef PMF_BODY_H
#define PMF_BODY_H

/* Places of the parameters. The sizes a_j of the forces follow, then the free constants of the forces. */
enum {
    PMF_BODY_MASS,
    PMF_BODY_VISCOUS,
    PMF_BODY_COULOMB,
    PMF_BODY_OFFSET, /* c, also half the difference of the Coulomb frictions of both directions */
    PMF_BODY_DIRECTIONAL, /* e, half the difference of the viscous frictions of both directions */
    PMF_BODY_DELAY, /* [s], >= 0 */
    PMF_BODY_LAG, /* [s], >= 0; 0 means no lag */
    PMF_BODY_X0,
    PMF_BODY_V0,
    PMF_BODY_BASE
};

/* Parameters of the controller, after the free constants of the forces. */
enum { PMF_LOOP_GAIN, PMF_LOOP_LIMIT, PMF_LOOP_DELAY, PMF_LOOP_PARAMETERS };

/* Kinds of forces h(x, v). Constants p and q belong to the kind; s is the direction of motion. */
enum {
    PMF_FORCE_STRIBECK, /* s exp(-(v/p)^2) */
    PMF_FORCE_SMOOTH, /* s (tanh(|v|/p) - 1), with which friction of the same size rises smoothly from rest */
    PMF_FORCE_POWER, /* s |v/q|^p */
    PMF_FORCE_WAVE, /* sin(2 pi x / p + q) */
    PMF_FORCE_RUB, /* s sin(2 pi x / p + q) */
    PMF_FORCE_SPRING, /* x - q */
    PMF_FORCE_SPEED, /* s times a table over |v|, with values at p + q i */
    PMF_FORCE_BEND, /* s times a bend from slope 0 at |v| = p to slope 1 at q and above */
    PMF_FORCE_BEND_EVEN, /* the bend, with the same sign in both directions */
    PMF_FORCE_PLACE, /* a table over x */
    PMF_FORCE_RUB_PLACE, /* s times a table over x */
    PMF_FORCE_COLUMN, /* a column of the record, for example a measured force */
    PMF_FORCE_COLUMN_FRICTION, /* s times a column, for example a temperature */
    PMF_FORCE_COLUMN_VISCOUS, /* v times a column; with a controller, the drag of its motor */
    PMF_FORCE_LOAD, /* s |T|, T: force through the gear: that of the motor with its drag, and 1 - q of all loads */
    PMF_FORCE_LOAD_STRIBECK, /* s |T| exp(-(v/p)^2) */
    PMF_FORCE_SLOPE, /* 0, but |v| times the size lowers the limit of a controller's force along q v */
    /* forces of the loop, which a controller has within its limit */
    PMF_LOOP_FILTERED, /* the velocity of y after a lag of p */
    PMF_LOOP_INTEGRAL /* minus the integral of g - y */
};

typedef struct {
    int kind;
    int column; /* row of the columns, for the kinds with a column */
    int unknown; /* 1 if the constant p is a parameter */
    int knots; /* length of the table */
    int load; /* 1 if the force acts on the second mass of an elastic axis */
    const double *table; /* (knots) values at p + q i */
    double p, q;
} pmf_force;

typedef struct {
    int n; /* intervals between instants */
    int parts; /* parts of an interval if there are forces or a lag */
    int forces, shapes; /* numbers of forces and of free constants */
    int rows; /* number of instants in the result */
    const int *row; /* (rows) rising instants in the result, 0 to n */
    const double *step; /* (n) lengths of the intervals [s] */
    const double *u; /* (n) force of the input in each interval [N], or its value */
    const pmf_force *force;
    const double *column; /* (columns, n) */
    double tick; /* longest part of an interval with a controller [s], or 0 without one */
    const double *on; /* (n) 0 where the controller is off; may be null */
    double count; /* step of the encoder of a controller in ticks, or 0: `on` is 1 at a tick, and -1 where it is off */
    int side; /* 1 if an elastic axis shows its second mass */
    int coordinates, links; /* number of coordinates, and of slopes of the parameters by them */
    const int *parameter, *coordinate; /* (links) places in w and among the coordinates */
    const double *slope; /* (links) */
} pmf_body;

/* A force of size 1, and its derivatives by position, velocity and the constant p. */
typedef struct {
    double h, hx, hv, hp;
} pmf_push;

/* The force f with the constant p at position x and velocity v in direction s, with the value of its column. */
pmf_push pmf_force_at(const pmf_force *f, double p, double x, double v, double s, double column);

/* Add the derivatives by the coordinates to a row of S, from those dx (w) by the parameters: the chain rule. */
void pmf_body_chain(const pmf_body *body, const double *dx, double *row);

/* Simulate the motion at theta (w), w = PMF_BODY_BASE + forces + shapes, + PMF_LOOP_PARAMETERS with a controller:
 * positions y (rows), velocities v (rows), derivatives S (rows, coordinates) of y, which are zero before.
 *
 * v and S may be null. `work` has room for pmf_body_work numbers. Returns the number of rows before the motion
 * overflows. */
int pmf_body_work(const pmf_body *body);
int pmf_body_run(const pmf_body *body, const double *theta, double *y, double *v, double *S, double *work);

#endif
