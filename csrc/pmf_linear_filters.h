/* Filters 1 / A(s) of a varying polynomial, exact for a held signal and trapezoidal for a sampled signal. Only
 * pmf_linear.c includes this file. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_LINEAR_FILTERS_H
#define PMF_LINEAR_FILTERS_H
#include "pmf_internal.h"

#if PMF_LINEAR
#define M PMF_MAX_ORDER
#define HALVINGS 6
#define TAYLOR 10U
#define SHIFTS 16U /* largest number of shifts of the roots to the left */

/* Return whether all roots are in the left half-plane (Routh 1877) and slow enough for the samples. */
static uint32_t plausible(const pmf_linear_config_t *config, const real_t *a)
{
    real_t row[2][M + 2]; /* two rows of the table, by turns */
    uint32_t n = config->n, i, k;
    for (i = 0; i < M + 2U; ++i) {
        row[0][i] = row[1][i] = PMF_R(0.0);
    }
    for (i = 0; i <= n; ++i) { /* every second coefficient, from the highest power */
        row[i % 2U][i / 2U] = i == 0U ? PMF_R(1.0) : a[n - i];
        if (i < n && !(a[i] > PMF_R(0.0) && a[i] < config->limit[i])) {
            return 0U;
        }
    }
    for (k = 0; k + 1U < n; ++k) {
        real_t *upper = row[k % 2U];
        const real_t *lower = row[(k + 1U) % 2U];
        real_t ratio = upper[0] / lower[0];
        for (i = 0; i + 1U < M + 2U; ++i) {
            upper[i] = upper[i + 1U] - ratio * lower[i + 1U];
        }
        upper[M + 1] = PMF_R(0.0);
        if (!(upper[0] > PMF_R(0.0))) {
            return 0U;
        }
    }
    return 1U;
}

/* Compute matrix = companion * matrix, times a factor. */
static void companion(const real_t *a, uint32_t n, real_t factor, real_t matrix[M][M])
{
    uint32_t i, j;
    for (j = 0; j < n; ++j) {
        real_t last = PMF_R(0.0);
        for (i = 0; i < n; ++i) {
            last -= a[i] * matrix[i][j];
        }
        for (i = 0; i + 1U < n; ++i) {
            matrix[i][j] = factor * matrix[i + 1U][j];
        }
        matrix[n - 1U][j] = factor * last;
    }
}

/* Double the time: E = 2 E + E^2, g = 2 g + E g. */
static void twice(uint32_t n, real_t step[M][M], real_t gain[M])
{
    real_t square[M][M], moved[M];
    uint32_t i, j, k;
    for (i = 0; i < n; ++i) {
        moved[i] = PMF_R(2.0) * gain[i];
        for (j = 0; j < n; ++j) {
            moved[i] += step[i][j] * gain[j];
            square[i][j] = PMF_R(2.0) * step[i][j];
            for (k = 0; k < n; ++k) {
                square[i][j] += step[i][k] * step[k][j];
            }
        }
    }
    for (i = 0; i < n; ++i) {
        gain[i] = moved[i];
        for (j = 0; j < n; ++j) {
            step[i][j] = square[i][j];
        }
    }
}

/* Compute step = exp(companion) - 1 and gain, the last column of the integral of exp(companion t) over one sample. */
static void discretise(pmf_linear_filter_t *filter, uint32_t n)
{
    real_t h = PMF_R(1.0), sum[M][M];
    uint32_t i, j, k;
    for (k = 0; k < HALVINGS; ++k) {
        h *= PMF_R(0.5);
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            sum[i][j] = i == j ? PMF_R(1.0) : PMF_R(0.0);
        }
    }
    for (k = TAYLOR; k >= 2U; --k) { /* 1 + A h / 2 (1 + A h / 3 (...)) */
        companion(filter->a, n, h / (real_t)k, sum);
        for (i = 0; i < n; ++i) {
            sum[i][i] += PMF_R(1.0);
        }
    }
    for (i = 0; i < n; ++i) {
        filter->gain[i] = h * sum[i][n - 1U];
    }
    companion(filter->a, n, h, sum);
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            filter->step[i][j] = sum[i][j];
        }
    }
    for (k = 0; k < HALVINGS; ++k) {
        twice(n, filter->step, filter->gain);
    }
}

/* Compute the filter of a polynomial. A filter for sampled signals only has no step. */
static void make_filter(pmf_linear_filter_t *filter, uint32_t n, const real_t *a, uint32_t stepping)
{
    real_t divisor = PMF_R(1.0), part = PMF_R(1.0);
    uint32_t i;
    for (i = n; i-- > 0U;) {
        part *= PMF_R(0.5);
        divisor += a[i] * part;
        filter->a[i] = a[i];
    }
    filter->inverse = PMF_R(1.0) / divisor;
    if (stepping != 0U) {
        discretise(filter, n);
    }
}

/* Compute left = (1 + E / 2)^-1 E and right = (1 + E / 2)^-1 g. In means of both ends, x[k+1] = x[k] + E x[k] + g u is
 * x[k+1] - x[k] = left (x[k] + x[k+1]) / 2 + right u. */
static void mean_form(const pmf_linear_filter_t *filter, uint32_t n, real_t left[M][M], real_t right[M])
{
    real_t half[M][M];
    uint32_t i, j, k;
    for (i = 0; i < n; ++i) {
        right[i] = filter->gain[i];
        for (j = 0; j < n; ++j) {
            left[i][j] = filter->step[i][j];
            half[i][j] = PMF_R(0.5) * filter->step[i][j] + (i == j ? PMF_R(1.0) : PMF_R(0.0));
        }
    }
    for (k = 0; k < n; ++k) { /* Gauss and Jordan; the pivots are near 1 */
        real_t inverse = PMF_R(1.0) / half[k][k];
        for (i = 0; i < n; ++i) {
            real_t factor = half[i][k] * inverse;
            if (i == k) {
                continue;
            }
            right[i] -= factor * right[k];
            for (j = 0; j < n; ++j) {
                left[i][j] -= factor * left[k][j];
                half[i][j] -= factor * half[k][j];
            }
        }
    }
    for (i = 0; i < n; ++i) {
        real_t inverse = PMF_R(1.0) / half[i][i];
        right[i] *= inverse;
        for (j = 0; j < n; ++j) {
            left[i][j] *= inverse;
        }
    }
}

/* Compute the transfer function between samples as a function of s_T, the variable of the trapezoidal filters (Faddeev
 * and LeVerrier). `a` is the denominator. `top` and `unit` are the numerators of the rows b and one. */
static void sampled_form(const pmf_linear_filter_t *filter, uint32_t n, const real_t *b, real_t one, real_t *a,
                         real_t *top, real_t *unit)
{
    real_t left[M][M], right[M], adjoint[M][M], moved[M][M];
    uint32_t i, j, k, l;
    mean_form(filter, n, left, right);
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            adjoint[i][j] = i == j ? PMF_R(1.0) : PMF_R(0.0);
        }
    }
    for (k = n; k-- > 0U;) {
        real_t trace = PMF_R(0.0);
        top[k] = unit[k] = PMF_R(0.0);
        for (i = 0; i < n; ++i) {
            for (j = 0; j < n; ++j) {
                top[k] += b[i] * adjoint[i][j] * right[j];
                moved[i][j] = PMF_R(0.0);
                for (l = 0; l < n; ++l) {
                    moved[i][j] += left[i][l] * adjoint[l][j];
                }
            }
            unit[k] += one * adjoint[0][i] * right[i];
            trace += moved[i][i];
        }
        a[k] = -trace / (real_t)(n - k);
        for (i = 0; i < n; ++i) {
            for (j = 0; j < n; ++j) {
                adjoint[i][j] = moved[i][j] + (i == j ? a[k] : PMF_R(0.0));
            }
        }
    }
}

/* Compute A(s + rate): all roots move to the left by the rate. */
static void shift(uint32_t n, real_t rate, real_t *a)
{
    uint32_t i, k;
    for (k = 0; k < n; ++k) {
        for (i = n; i-- > k;) {
            a[i] += rate * (i + 1U == n ? PMF_R(1.0) : a[i + 1U]);
        }
    }
}

/* Return whether all roots decay at least at this rate and are slow enough for the samples. */
static uint32_t decays(const pmf_linear_config_t *config, const real_t *a, real_t rate)
{
    real_t moved[M];
    uint32_t i;
    for (i = 0; i < M; ++i) {
        moved[i] = i < config->n ? a[i] : PMF_R(0.0);
    }
    shift(config->n, -rate, moved);
    return plausible(config, moved);
}

/* Shift all roots to the left until they decay at `rate`. Returns 0 if the number of shifts did not suffice. */
static uint32_t damp(const pmf_linear_config_t *config, real_t *a, real_t rate)
{
    uint32_t shifts;
    for (shifts = 0U; shifts < SHIFTS; ++shifts) {
        if (decays(config, a, rate) != 0U) {
            return 1U;
        }
        shift(config->n, rate, a);
    }
    return 0U;
}

/* Compute x += E x + g u: exact for a held u. */
static void held(const pmf_linear_filter_t *filter, uint32_t n, real_t u, real_t x[M])
{
    real_t moved[M];
    uint32_t i, j;
    for (i = 0; i < n; ++i) {
        moved[i] = filter->gain[i] * u;
        for (j = 0; j < n; ++j) {
            moved[i] += filter->step[i][j] * x[j];
        }
    }
    for (i = 0; i < n; ++i) {
        x[i] += moved[i];
    }
}

/* Apply the trapezoidal rule with the mean of a signal over the sample. With the last state's increment q, the middle
 * of the states is c + q / 2^(n-i). In a sample, a state grows by the middle of the next state. */
static void trapezoidal(const pmf_linear_filter_t *filter, uint32_t n, real_t mean, real_t w[M])
{
    real_t middle[M + 1], q = mean;
    uint32_t i;
    middle[n] = PMF_R(0.0);
    for (i = n; i-- > 0U;) {
        middle[i] = w[i] + PMF_R(0.5) * middle[i + 1U];
        q -= filter->a[i] * middle[i];
    }
    middle[n] = q * filter->inverse;
    for (i = n; i-- > 0U;) {
        middle[i] = w[i] + PMF_R(0.5) * middle[i + 1U];
        w[i] += middle[i + 1U];
    }
}
#endif
#endif
