/* The information of count edges on a normal distribution of place, velocity and parameters. Only pmf_within.h includes
 * this file. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_EDGES_H
#define PMF_EDGES_H

#include "pmf_motion.h"

#if PMF_FOUND

#define WIDE PMF_R(0.1) /* variance of the place above which a count stands for the middle of its interval */
#define TWELFTH (PMF_R(1.0) / PMF_R(12.0))
#define BLUR PMF_R(0.05) /* standard deviation of an edge by unmodelled effects */
#define FIRST_BLUR PMF_R(0.5) /* error of the first linearisation */
#define BLUR_AGE PMF_R(5.0) /* memory with which the error of the first linearisation fades */
#define EDGE_MEMORY PMF_R(0.998)
#define NEAR PMF_R(3.0) /* distance of a place near an edge, in standard deviations */
#define FAR PMF_R(5.0) /* distance from an edge beyond which a count has no information */

/* Density over distribution of a standard normal variable, from -6 in steps of a quarter. */
static const scalar_t mills[45] = {
    PMF_SCALAR(6.1584826),      PMF_SCALAR(5.91470462),     PMF_SCALAR(5.67141031),     PMF_SCALAR(5.42865539),
    PMF_SCALAR(5.18650397),     PMF_SCALAR(4.94503014),     PMF_SCALAR(4.70431984),     PMF_SCALAR(4.46447317),
    PMF_SCALAR(4.22560714),     PMF_SCALAR(3.98785918),     PMF_SCALAR(3.75139126),     PMF_SCALAR(3.51639514),
    PMF_SCALAR(3.28309865),     PMF_SCALAR(3.05177351),     PMF_SCALAR(2.8227448),      PMF_SCALAR(2.59640254),
    PMF_SCALAR(2.37321553),     PMF_SCALAR(2.15374775),     PMF_SCALAR(1.93867717),     PMF_SCALAR(1.72881663),
    PMF_SCALAR(1.52513528),     PMF_SCALAR(1.32877797),     PMF_SCALAR(1.14107777),     PMF_SCALAR(0.963553979),
    PMF_SCALAR(0.797884561),    PMF_SCALAR(0.645839371),    PMF_SCALAR(0.509160434),    PMF_SCALAR(0.389382057),
    PMF_SCALAR(0.287599971),    PMF_SCALAR(0.204225459),    PMF_SCALAR(0.13878975),     PMF_SCALAR(0.0898777455),
    PMF_SCALAR(0.0552478627),   PMF_SCALAR(0.0321324541),   PMF_SCALAR(0.0176378255),   PMF_SCALAR(0.00912074015),
    PMF_SCALAR(0.00443783904),  PMF_SCALAR(0.00203021954),  PMF_SCALAR(0.000872885754), PMF_SCALAR(0.000352626861),
    PMF_SCALAR(0.000133834464), PMF_SCALAR(4.77191466e-05), PMF_SCALAR(1.59837954e-05), PMF_SCALAR(5.0295124e-06),
    PMF_SCALAR(1.48671994e-06),
};

/* Return the ratio r at t < 5 by cubic interpolation with the exact slope -r (r + t). */
static real_t mills_ratio(real_t t)
{
    real_t at = (t + PMF_R(6.0)) * PMF_R(4.0), knot, low, high, fall, falls;
    uint32_t i;
    if (!(t > PMF_R(-6.0))) {
        real_t far = PMF_R(-1.0) / t;
        return -t + far * (PMF_R(1.0) - PMF_R(2.0) * far * far);
    }
    i = at < PMF_R(43.0) ? (uint32_t)at : 43U;
    at -= (real_t)i;
    knot = PMF_R(-6.0) + PMF_R(0.25) * (real_t)i;
    low = mills[i];
    high = mills[i + 1U];
    fall = PMF_R(-0.25) * low * (low + knot);
    falls = PMF_R(-0.25) * high * (high + knot + PMF_R(0.25));
    return low + at * (fall + at * (PMF_R(3.0) * (high - low) - PMF_R(2.0) * fall - falls +
                                    at * (PMF_R(2.0) * (low - high) + fall + falls)));
}

/* Return the square root of a variance by Newton's method, for variances from an edge to a narrow place. */
static real_t deviation_of(real_t variance)
{
    real_t root = PMF_R(0.5) * (variance / PMF_R(0.13) + PMF_R(0.13));
    uint32_t i;
    for (i = 0; i < 5U; ++i) {
        root = PMF_R(0.5) * (root + variance / root);
    }
    return root;
}
/* Update the covariance after a motion of place and velocity. */
static void carry(pmf_found_state_t *found, const motion_t *motion, uint32_t n)
{
    real_t place[MOST_KNOWN], velocity[MOST_KNOWN];
    real_t own = PMF_R(0.0), both = PMF_R(0.0), speed = PMF_R(0.0);
    uint32_t i, j;
    for (i = 0; i < MOST_KNOWN; ++i) {
        place[i] = velocity[i] = PMF_R(0.0);
        for (j = 0; j < n && i < n; ++j) {
            place[i] += motion->place_by[j] * found->covariance[j][i];
            velocity[i] += motion->velocity_by[j] * found->covariance[j][i];
        }
    }
    for (i = 0; i < n; ++i) {
        own += place[i] * motion->place_by[i];
        both += place[i] * motion->velocity_by[i];
        speed += velocity[i] * motion->velocity_by[i];
    }
    for (i = FIRST; i < n; ++i) {
        found->covariance[PLACE][i] = found->covariance[i][PLACE] = place[i];
        found->covariance[SPEED][i] = found->covariance[i][SPEED] = velocity[i];
    }
    found->covariance[PLACE][PLACE] = own;
    found->covariance[PLACE][SPEED] = found->covariance[SPEED][PLACE] = both;
    found->covariance[SPEED][SPEED] = speed;
}

/* Update all numbers after one number moved by `moved` and lost the fraction `gone` of its variance. */
static void learn(pmf_found_state_t *found, uint32_t n, uint32_t which, real_t moved, real_t gone)
{
    real_t gain[MOST_KNOWN], own = found->covariance[which][which];
    uint32_t i, j;
    for (i = 0; i < MOST_KNOWN; ++i) {
        gain[i] = i < n ? found->covariance[i][which] / own : PMF_R(0.0);
    }
    found->place += gain[PLACE] * moved;
    found->velocity += gain[SPEED] * moved;
    for (i = FIRST; i < n; ++i) {
        found->theta[i - FIRST] += gain[i] * moved;
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j <= i; ++j) {
            found->covariance[i][j] -= gain[i] * gain[j] * own * gone;
            found->covariance[j][i] = found->covariance[i][j];
        }
    }
}

/* Compare the violations of an edge to their expected number and size. */
static void note_edge(pmf_found_state_t *found, real_t t, real_t ratio)
{
    real_t square = t * t;
    if (t < NEAR && t > -NEAR) {
        real_t other = mills_ratio(-t), beyond = ratio / (ratio + other);
        found->surprise *= EDGE_MEMORY;
        found->expected = EDGE_MEMORY * found->expected + square * beyond;
        found->near += found->near < PMF_OLDEST ? 1U : 0U;
    }
    found->surprise += t < PMF_R(0.0) ? square : PMF_R(0.0);
}

/* Apply a count to the place, which is between two edges. Only the nearer edge cuts the distribution. */
static void cut_off(pmf_found_state_t *found, uint32_t n)
{
    real_t variance = found->covariance[PLACE][PLACE], up = PMF_R(1.0) - found->place, blur, all, root, t, ratio;
    uint32_t above = up < found->place;
    if (variance > WIDE) {
        real_t gone = variance / (variance + TWELFTH);
        learn(found, n, PLACE, (PMF_R(0.5) - found->place) * gone, gone);
        return;
    }
    blur = BLUR_AGE / (real_t)(found->age + 1U);
    blur = blur < FIRST_BLUR ? blur : FIRST_BLUR;
    blur = blur > BLUR ? blur : BLUR;
    all = variance + blur * blur;
    root = deviation_of(all);
    t = (above != 0U ? up : found->place) / root;
    if (t < FAR) {
        ratio = mills_ratio(t);
        note_edge(found, t, ratio);
        t = ratio * (ratio + t) * variance / all;
        ratio *= variance / root;
        learn(found, n, PLACE, above != 0U ? -ratio : ratio, t);
    }
}

#endif
#endif
