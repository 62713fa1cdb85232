/* Small symmetric matrices: factors, triangular systems, projections. Only pmf_recursion.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */

#define N PMF_MAX_PARAMETERS

/* Factorise a symmetric matrix, given by its lower half, as L D L^T. */
PMF_INLINE void factorise(uint32_t p, real_t matrix[N][N], real_t lower[N][N], real_t inverse[N])
{
    real_t scaled[N];
    uint32_t i, j, k;
    for (i = 0; i < p; ++i) {
        real_t pivot = matrix[i][i], floor = PMF_EITHER(1e-6, 1e-14) * matrix[i][i] + PMF_TINY;
        for (j = 0; j < i; ++j) {
            real_t sum = matrix[i][j];
            for (k = 0; k < j; ++k) {
                sum -= scaled[k] * lower[j][k];
            }
            scaled[j] = sum;
            lower[i][j] = sum * inverse[j];
            pivot -= sum * lower[i][j];
        }
        inverse[i] =
            PMF_R(1.0) / PMF_IF(pivot > floor, pivot, floor); /* a floor > 0 keeps P positive for any information */
    }
}

/* Return the smallest pivot relative to its diagonal entry. */
PMF_SELDOM real_t smallest_pivot(uint32_t p, real_t matrix[N][N], const real_t inverse[N])
{
    real_t smallest = PMF_R(1.0), relative;
    uint32_t i;
    for (i = 0; i < p; ++i) {
        relative = PMF_IF(matrix[i][i] > PMF_TINY, PMF_R(1.0) / (inverse[i] * matrix[i][i]), PMF_R(0.0));
        smallest = PMF_IF(relative < smallest, relative, smallest);
    }
    return smallest;
}

PMF_INLINE void forward(uint32_t p, real_t lower[N][N], real_t x[N])
{
    uint32_t i, j;
    for (i = 1; i < p; ++i) {
        for (j = 0; j < i; ++j) {
            x[i] -= lower[i][j] * x[j];
        }
    }
}

PMF_INLINE void backward(uint32_t p, real_t lower[N][N], real_t x[N])
{
    uint32_t i, j;
    for (i = p; i-- > 1U;) {
        for (j = 0; j < i; ++j) {
            x[j] -= lower[i][j] * x[i];
        }
    }
}

/* Compute row i of half = L^-1 W from the rows above it. */
PMF_INLINE void forward_row(uint32_t p, uint32_t i, real_t cross[N][N], real_t lower[N][N], real_t half[N][N])
{
    uint32_t j, k;
    for (j = 0; j < p; ++j) {
        real_t sum = cross[i][j];
        for (k = 0; k < i; ++k) {
            sum -= lower[i][k] * half[k][j];
        }
        half[i][j] = sum;
    }
}

/* Z = L D L^T, and half = L^-1 W. */
typedef struct {
    real_t lower[N][N], inverse[N], half[N][N];
} projection_t;

/* Compute the projection and information = W^T Z^-1 W (lower half). */
PMF_INLINE void project_information(pmf_recursion_state_t *state, uint32_t p, projection_t *projection,
                                    real_t information[N][N])
{
    uint32_t i, j, k;
    factorise(p, state->sums.square, projection->lower, projection->inverse);
    for (k = 0; k < p; ++k) {
        forward_row(p, k, state->sums.cross, projection->lower, projection->half);
        for (i = 0; i < p; ++i) {
            real_t weighted = projection->half[k][i] * projection->inverse[k];
            for (j = 0; j <= i; ++j) {
                information[i][j] = (k > 0U ? information[i][j] : PMF_R(0.0)) + weighted * projection->half[k][j];
            }
        }
    }
}

/* Compute move = W^T Z^-1 move. */
PMF_INLINE void project(uint32_t p, projection_t *projection, real_t move[N])
{
    real_t scaled[N];
    uint32_t i, k;
    forward(p, projection->lower, move);
    for (i = 0; i < p; ++i) {
        scaled[i] = move[i] * projection->inverse[i];
    }
    for (i = 0; i < p; ++i) {
        move[i] = PMF_R(0.0);
        for (k = 0; k < p; ++k) {
            move[i] += projection->half[k][i] * scaled[k];
        }
    }
}
