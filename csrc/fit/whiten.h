/* Whitening of residuals for an error of the counts and a disturbance that wanders.
 *
 * SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_WHITEN_H
#define PMF_WHITEN_H

typedef struct {
    double rate; /* viscous friction over mass [1/s], by which the velocity decays */
    double force_sd; /* standard deviation of the acceleration by a force that wanders [counts/s^2] */
    double force_memory; /* its time constant [s] */
    double position_sd; /* standard deviation of an error of the position that wanders [counts] */
    double position_memory; /* its time constant [s] */
} pmf_wander;

/* Replace each column of X (n, w) [counts] by its innovations over their standard deviation: a Kalman filter whose
 * states are position, velocity and acceleration by the force, and the error of the position (Ornstein and Uhlenbeck
 * 1930). `step` (n) are the times to the next row [s], negative while the mass rests, when a force does not move it.
 * `variance` (n) are those of the white errors [counts^2]. `work` has
 * room for 4 w numbers. Returns the sum of the logarithms of the innovation variances. */
double pmf_whiten(const pmf_wander *wander, int n, int w, const double *step, const double *variance, double *X,
                  double *work);

#endif
