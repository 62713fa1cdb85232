/* Rows of samples and of estimates, for one axis and for lanes. SPDX-License-Identifier: Apache-2.0 */

static const unsigned char *row_at(const pmf_rows_t *rows, uint64_t axis, uint64_t sample)
{
    return rows->start + (int64_t)axis * rows->axis + (int64_t)sample * rows->sample;
}

static inline scalar_t input_at(const pmf_rows_t *rows, uint64_t axis, uint64_t sample)
{
    const void *at = row_at(rows, axis, sample);
    return rows->size == 4U ? (scalar_t) * (const float *)at : (scalar_t) * (const double *)at;
}

static inline uint32_t count_at(const pmf_rows_t *rows, uint64_t axis, uint64_t sample)
{
    const void *at = row_at(rows, axis, sample);
    return rows->size == 4U ? *(const uint32_t *)at : (uint32_t)*(const uint64_t *)at;
}

/* Keep the estimate of a lane in a row. */
static void keep(const pmf_config_t *config, const pmf_state_t *state, const pmf_many_t *many, uint32_t lane,
                 uint64_t row)
{
    const pmf_estimate_t *estimate = config->auxiliary.enabled != 0U               ? &state->output
                                     : config->direct.constant != PMF_NO_PARAMETER ? &state->lifted
                                                                                   : &state->direct.estimate;
    uint32_t p = pmf_parameters(config), i;
    for (i = 0; i < p; ++i) {
        many->theta[row * p + i] = (double)PMF_LANE(estimate->theta[i], lane);
        many->variance_factor[row * p + i] = (double)PMF_LANE(estimate->variance_factor[i], lane);
        many->inflation[row * p + i] = (double)PMF_LANE(estimate->inflation[i], lane);
    }
    many->innovation[row] = (double)PMF_LANE(estimate->innovation, lane);
    many->innovation_variance[row] = (double)PMF_LANE(estimate->innovation_variance, lane);
    many->status[row] = (uint32_t)PMF_LANE(state->status, lane);
}
