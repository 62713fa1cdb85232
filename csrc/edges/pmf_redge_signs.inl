/* Signs of a wrong model, or of another machine, in the innovations. Only pmf_redge.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */

static const real_t OUTLIER = PMF_R(25.0); /* squared innovation over its variance of an edge by noise, */
static const real_t USUAL = PMF_R(9.0); /* and most of the edge before */
static const real_t RECENT = PMF_R(16.0); /* edges: memory of the surprise */
static const real_t COLOURED = PMF_R(64.0); /* edges: memory of the covariance of successive innovations, */
static const real_t CORRELATED = PMF_R(128.0); /* and of their correlation */
static const uint32_t BLOCK = 16U; /* edges */
static const real_t BLOCKS = PMF_R(16.0); /* memory of the blocks */
static const real_t MOST_SIZE = PMF_R(100.0); /* mean squared innovation [counts^2] that an alarm takes for true */
static const real_t ALARM = PMF_R(6.0); /* mean squared innovation over its variance: another machine or model */
static const real_t VISIBLE = PMF_R(4e-4); /* smaller mean squared innovations [counts^2] are no alarm */
static const uint32_t RECENT_EDGES = 24U; /* edges after an alarm before the correlation is known */
static const real_t MOST_RATIO = PMF_R(100.0); /* squared innovation over its variance, as surprise and trend take it */
static const uint32_t CALM = 8U; /* edges before an alarm */
static const real_t TREND = PMF_R(0.3); /* correlation of innovations, of an alarm */
static const real_t COLOUR = PMF_R(0.3); /* covariance over the variance from which on the model is wrong */
static const real_t CORRELATION = PMF_R(0.2); /* correlation from which on the model is wrong; chance makes 0.06 */
static const real_t CORRELATION_OF_FEW = PMF_R(5.0); /* the same, of one edge */
static const real_t FURTHER = PMF_R(3.0); /* squared moves of blocks over those by chance, of a wrong model */
static const real_t FURTHER_OF_FEW = PMF_R(8.0); /* the same, of one block */
static const real_t TURNS = PMF_R(32.0); /* reversals: memory of the first innovations after them */
static const real_t TURN_OUTLIER = PMF_R(16.0); /* squared innovation over its variance, above which it counts less */
static const real_t TURN_TREND = PMF_R(25.0); /* squared mean of these over its variance, of a wrong model (5 sd) */

/* Note the first innovation after a reversal. Friction that is another at low speed moves all of these edges the same
 * way, relative to the motion. */
static void note_turn(pmf_redge_state_t *state, const pmf_edge_t *edge, real_t way)
{
    real_t square = edge->value * edge->value / edge->variance, kept = PMF_R(1.0) - PMF_R(1.0) / TURNS;
    real_t heading = state->heading;
    state->heading = way;
    if (heading * way >= PMF_R(0.0)) {
        return;
    }
    square = smaller(square, MOST_SIZE);
    state->turned = kept * state->turned +
                    way * edge->value / edge->variance * (square > TURN_OUTLIER ? TURN_OUTLIER / square : PMF_R(1.0));
    state->turned_known = kept * kept * state->turned_known + PMF_R(1.0) / edge->variance;
}

/* Return the squared mean of the first innovations after reversals over its variance. */
static real_t turn_trend(const pmf_redge_state_t *state)
{
    return state->turned_known > PMF_R(0.0) ? state->turned * state->turned / state->turned_known : PMF_R(0.0);
}

/* Note size and correlation of the innovations. */
static void note_surprise(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    real_t square, alike, smallest;
    real_t one = PMF_R(1.0) / ((real_t)state->calm + PMF_R(1.0)), ratio = edge->value * edge->value / edge->variance;
    real_t both = edge->value * state->last / (PMF_R(0.5) * (edge->variance + state->last_variance));
    real_t gain = larger(one, PMF_R(1.0) / RECENT);
    state->surprise += gain * (smaller(ratio, MOST_RATIO) - state->surprise);
    state->size += gain * (edge->value * edge->value - state->size);
    smallest = smaller(smaller(ratio, state->last * state->last / state->last_variance), MOST_RATIO);
    state->trend += gain * ((both > PMF_R(0.0) ? smallest : -smallest) - state->trend); /* not by a single one */
    both = smaller(larger(both, -MOST_SURPRISE), MOST_SURPRISE);
    square = edge->value * edge->value + state->last * state->last + PMF_R(2.0) * config->finest * config->finest;
    alike = PMF_R(2.0) * edge->value * state->last / square; /* from -1 to 1, whatever the size of the innovations */
    state->colour += larger(one, PMF_R(1.0) / COLOURED) * (both - state->colour); /* sees a change at once */
    state->correlation += larger(one, PMF_R(1.0) / CORRELATED) * (alike - state->correlation);
    state->last = edge->value;
    state->last_variance = edge->variance;
    state->innovation = edge->value;
}

/* Note how much further the parameters moved in a block of edges than by corrections without a correlation. */
static void note_block(pmf_redge_state_t *state)
{
    real_t gain = larger(PMF_R(1.0) / ((real_t)state->blocks + PMF_R(1.0)), PMF_R(1.0) / BLOCKS);
    uint32_t i;
    state->in_block += 1U;
    if (state->in_block < BLOCK) {
        return;
    }
    for (i = 0; i < PMF_BODY; ++i) {
        real_t moved = state->block_moved[i] * state->block_moved[i];
        if (moved > PMF_R(0.0)) {
            state->further[i] += gain * (moved / state->block_squares[i] - state->further[i]);
        }
        state->block_moved[i] = state->block_squares[i] = PMF_R(0.0);
    }
    state->blocks += state->blocks < LAST_WINDOW ? 1U : 0U;
    state->in_block = 0U;
}

/* Return 1 if the innovations are too large and are no noise: noise has no trend. */
static uint32_t is_alarm(const pmf_redge_state_t *state)
{
    real_t late = state->velocity * LATE;
    return state->calm >= CALM && state->surprise > ALARM && state->trend > TREND * state->surprise &&
                   state->size > VISIBLE + late * late
               ? 1U
               : 0U;
}

/* Return 1 if the edge is far off and the one before was not: an edge of noise. A change makes several such edges. */
static uint32_t is_alone(const pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    return state->calm >= CALM && edge->value * edge->value > OUTLIER * edge->variance &&
                   state->last * state->last < USUAL * state->last_variance
               ? 1U
               : 0U;
}

/* Return 1 if the innovations depend on each other: the right model leaves none that do. */
static uint32_t is_correlated(const pmf_redge_state_t *state)
{
    real_t few;
    uint32_t i, found;
    found = state->calm >= RECENT_EDGES && (state->colour > COLOUR ||
                                            state->correlation > CORRELATION + CORRELATION_OF_FEW / (real_t)state->calm)
                ? 1U
                : 0U;
    found |= turn_trend(state) > TURN_TREND ? 1U : 0U;
    few = FURTHER_OF_FEW / ((real_t)state->blocks + PMF_R(1.0));
    for (i = 0; i < PMF_BODY; ++i) {
        found |= state->further[i] > FURTHER + few ? 1U : 0U;
    }
    return found;
}
