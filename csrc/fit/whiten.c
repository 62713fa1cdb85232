/* SPDX-License-Identifier: Apache-2.0 */
#include "whiten.h"
#include <math.h>
#include <string.h>

/* Transition over one step: x += a v + c f, v = b v + e f, f = g f, p = r p; qf and qp are variances that enter. */
typedef struct {
    double a, b, c, e, g, r, qf, qp;
} transition;

static transition transition_of(const pmf_wander *k, double step)
{
    const double h = fabs(step), moves = step > 0;
    const double z = k->rate * h, b = exp(-z);
    const double p1 = fabs(z) < 1e-5 ? 1 - z / 2 : (1 - b) / z,
                 p2 = fabs(z) < 1e-3 ? 0.5 - z / 6 + z * z / 24 : (1 - p1) / z;
    const double g = k->force_sd > 0 ? exp(-h / k->force_memory) : 0,
                 r = k->position_sd > 0 ? exp(-h / k->position_memory) : 0;
    transition t = {moves * h * p1,
                    moves * b,
                    moves * h * h * p2,
                    moves * h * p1,
                    g,
                    r,
                    k->force_sd * k->force_sd * (1 - g * g),
                    k->position_sd * k->position_sd * (1 - r * r)};
    return t;
}

/* P = F P F' + Q for the states x, v, f, p. */
static void predict(double P[4][4], const transition *t)
{
    double A[4][4];
    for (int j = 0; j < 4; j++) {
        A[0][j] = P[0][j] + t->a * P[1][j] + t->c * P[2][j];
        A[1][j] = t->b * P[1][j] + t->e * P[2][j];
        A[2][j] = t->g * P[2][j];
        A[3][j] = t->r * P[3][j];
    }
    for (int i = 0; i < 4; i++) {
        P[i][0] = A[i][0] + t->a * A[i][1] + t->c * A[i][2];
        P[i][1] = t->b * A[i][1] + t->e * A[i][2];
        P[i][2] = t->g * A[i][2];
        P[i][3] = t->r * A[i][3];
    }
    P[2][2] += t->qf;
    P[3][3] += t->qp;
}

double pmf_whiten(const pmf_wander *k, int n, int w, const double *step, const double *variance, double *X,
                  double *work)
{
    double P[4][4] = {{0}}, sum = 0, last = -1, *x = work, *v = work + w, *f = work + 2 * w, *p = work + 3 * w;
    transition t = {0};
    P[2][2] = k->force_sd * k->force_sd;
    P[3][3] = k->position_sd * k->position_sd;
    memset(work, 0, 4 * (size_t)w * sizeof *work);
    for (int i = 0; i < n; i++) {
        double *row = X + (size_t)i * w, H[4], K[4];
        for (int j = 0; j < 4; j++)
            H[j] = P[0][j] + P[3][j];
        const double S = H[0] + H[3] + variance[i], root = 1 / sqrt(S);
        for (int j = 0; j < 4; j++)
            K[j] = H[j] / S;
        sum += log(S);
        for (int j = 0; j < 4; j++)
            for (int m = 0; m < 4; m++)
                P[j][m] -= K[j] * H[m];
        if (step[i] != last)
            t = transition_of(k, last = step[i]);
        predict(P, &t);
        for (int c = 0; c < w; c++) {
            const double y = row[c] - x[c] - p[c];
            const double x1 = x[c] + K[0] * y, v1 = v[c] + K[1] * y, f1 = f[c] + K[2] * y;
            row[c] = y * root;
            x[c] = x1 + t.a * v1 + t.c * f1;
            v[c] = t.b * v1 + t.e * f1;
            f[c] = t.g * f1;
            p[c] = t.r * (p[c] + K[3] * y);
        }
    }
    return sum;
}
