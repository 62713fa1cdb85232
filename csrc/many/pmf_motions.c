/* Motions of the auxiliary model under one input, for several parameters at once.
 * SPDX-License-Identifier: Apache-2.0
 *
 * This file is compiled like pmf_lanes.c, and once without vectors for one motion after the other. */
#ifdef PMF_LANE_BYTES
#define PMF_LANES (PMF_LANE_BYTES / 8)
#define PMF_MOTIONS
#include "../pmf_sizes.h"
#undef PMF_WINDOW_BLOCKS
#define PMF_WINDOW_BLOCKS 0
#include "../pmf_auxiliary.c"
#include "pmf_motions.h"
#define LANE(x, lane) (x)[lane]
#else
#include "pmf_motions.h"
#define PMF_LANES 1
#define LANE(x, lane) (x)
#endif

/* In lanes each motion has its own lag. */
typedef struct {
    real_t rest, mean, moment;
} lag_decay_t;
#define pmf_decay_t lag_decay_t
#include "../pmf_lag.h"
#undef pmf_decay_t

typedef struct {
    pmf_auxiliary_state_t state;
    pmf_late_state_t late;
    lag_decay_t decay[2];
    int64_t at[PMF_LANES]; /* sample of the active input, and the steps since its start */
    uint64_t gone[PMF_LANES];
    real_t part; /* fraction of a step in which the preceding input still acts */
    real_t acting, sum[3];
} run_t;

static uint64_t motion_of(const pmf_motions_t *motions, uint64_t first, uint32_t lane)
{
    return first + lane < motions->motions ? first + lane : motions->motions - 1U;
}

static void begin(const pmf_motions_t *motions, uint64_t first, int64_t *whole, run_t *run)
{
    double steps = (double)(motions->samples * motions->hold);
    uint32_t lane, i;
    pmf_clear(run, (uint32_t)sizeof *run);
    for (lane = 0; lane < PMF_LANES; ++lane) {
        uint64_t own = motion_of(motions, first, lane);
        const double *parameter = motions->parameter + own * PMF_ROLES;
        double late = parameter[PMF_DELAY] / motions->config->dt;
        late = late > 0.0 ? late < steps ? late : steps : 0.0;
        whole[lane] = (int64_t)late;
        LANE(run->part, lane) = late - (double)whole[lane];
        for (i = 0; i < PMF_ROLES; ++i) {
            LANE(run->state.parameter[i], lane) = parameter[i];
        }
        LANE(run->state.velocity, lane) = motions->velocity[own];
        LANE(run->state.position, lane) = motions->position[own];
        for (i = 0; motions->decay != 0 && i < 2U; ++i) {
            const double *decay = motions->decay + 6U * own + 3U * i;
            LANE(run->decay[i].rest, lane) = decay[0];
            LANE(run->decay[i].mean, lane) = decay[1];
            LANE(run->decay[i].moment, lane) = decay[2];
        }
        LANE(run->late.lagged, lane) = motions->before[0];
    }
}

static double input_at(const pmf_motions_t *motions, int64_t sample)
{
    int64_t past = (int64_t)motions->n_before + sample;
    return sample >= 0 ? motions->input[sample] : motions->before[past > 0 ? past : 0];
}

/* Find the input that acts before step `step`, if the input is late by `whole` (PMF_LANES) steps. */
static void find_input(const pmf_motions_t *motions, int64_t step, const int64_t *whole, run_t *run)
{
    int64_t hold = (int64_t)motions->hold;
    uint32_t lane;
    for (lane = 0; lane < PMF_LANES; ++lane) {
        int64_t at = step - 1 - whole[lane], sample = (at >= 0 ? at : at - hold + 1) / hold;
        run->at[lane] = sample;
        run->gone[lane] = (uint64_t)(at - sample * hold);
        LANE(run->acting, lane) = input_at(motions, sample);
    }
}

/* row of the additional force, from 0 */
static void take_inputs(const pmf_motions_t *motions, uint64_t first, int64_t row, run_t *run)
{
    pmf_late_state_t *late = &run->late;
    uint32_t lane;
    late->older = run->acting;
    for (lane = 0; lane < PMF_LANES; ++lane) {
        if (++run->gone[lane] == motions->hold) {
            run->gone[lane] = 0;
            LANE(run->acting, lane) = input_at(motions, ++run->at[lane]);
        }
    }
    late->newer = run->acting;
    late->part = run->part;
    if (motions->config->shapes.n != 0U && motions->decay == 0) { /* two phases take twice the work */
        late->part = PMF_IF(late->older == late->newer, PMF_R(0.0), late->part);
    }
    if (motions->decay != 0) {
        lag_input(run->decay, late);
    }
    if (row < 0 || motions->on_top == 0) {
        return;
    }
    for (lane = 0; lane < PMF_LANES; ++lane) {
        uint64_t own = motions->own_force ? motion_of(motions, first, lane) : 0U;
        double extra = motions->on_top[own * (motions->samples * motions->hold / motions->parts) + (uint64_t)row];
        LANE(late->newer, lane) += extra;
        LANE(late->older, lane) += extra;
    }
}

static void keep(const pmf_motions_t *motions, uint64_t first, uint64_t row, run_t *run)
{
    uint64_t rows = motions->samples * motions->hold / motions->parts;
    double *result[3] = {motions->mean, motions->direction, motions->moving};
    uint32_t lane, i;
    for (i = 0; i < 3U; ++i) {
        for (lane = 0; result[i] != 0 && lane < PMF_LANES && first + lane < motions->motions; ++lane) {
            result[i][(first + lane) * rows + row] = LANE(run->sum[i], lane) / (double)motions->parts;
        }
        run->sum[i] = PMF_R(0.0);
    }
}

/* Run the motions of one group of lanes. Returns the first motion of the next group. */
static uint64_t run_motions(const pmf_motions_t *motions, uint64_t first)
{
    pmf_auxiliary_config_t config = *motions->config;
    real_t signal[PMF_SIGNALS + PMF_MAX_SHAPES];
    run_t run;
    int64_t step, steps = (int64_t)(motions->samples * motions->hold), late = 0, row = 0, whole[PMF_LANES];
    uint32_t lane, part = 0;
    begin(motions, first, whole, &run);
    pmf_clear(signal, (uint32_t)sizeof signal);
    for (lane = 0; lane < PMF_LANES; ++lane) {
        late |= whole[lane] != 0 || LANE(run.part, lane) > 0.0;
    }
    late |= motions->decay != 0 || motions->on_top != 0;
    step = motions->decay != 0 ? -(int64_t)(motions->n_before * motions->hold) : 0;
    find_input(motions, step, whole, &run);
    for (; step < steps; ++step) {
        if (motions->span != 0) {
            config.dt = (scalar_t)(motions->span[step / (int64_t)motions->hold] / (double)motions->hold);
        }
        if (late == 0) {
            signal[PMF_LATE_INPUT] = PMF_ALIKE((scalar_t)motions->input[step / (int64_t)motions->hold]);
            pmf_auxiliary_step(&config, &run.state, signal);
        } else {
            take_inputs(motions, first, step < 0 ? -1 : row, &run);
            if (step < 0) {
                continue;
            }
            signal[PMF_LATE_INPUT] = run.late.newer + run.late.part * (run.late.older - run.late.newer);
            if (config.shapes.n != 0U && PMF_ALL(run.late.part == PMF_R(0.0))) {
                pmf_auxiliary_step(&config, &run.state, signal);
            } else {
                pmf_auxiliary_late_step(&config, &run.state, &run.late, signal);
            }
        }
        run.sum[0] += signal[PMF_AUXILIARY + PMF_VELOCITY];
        run.sum[1] += signal[PMF_AUXILIARY + PMF_DIRECTION];
        run.sum[2] += signal[PMF_AUXILIARY + PMF_MOVING];
        if (++part == motions->parts) {
            keep(motions, first, (uint64_t)row, &run);
            ++row;
            part = 0;
        }
    }
    for (lane = 0; lane < PMF_LANES && first + lane < motions->motions; ++lane) {
        motions->end[first + lane] = LANE(run.state.velocity, lane);
    }
    return first + PMF_LANES;
}

#ifndef PMF_LANE_BYTES
#define PMF_MOTIONS_NAME pmf_motions_1
#elif PMF_LANE_BYTES == 64
#define PMF_MOTIONS_NAME pmf_motions_64
#elif PMF_LANE_BYTES == 32
#define PMF_MOTIONS_NAME pmf_motions_32
#else
#define PMF_MOTIONS_NAME pmf_motions_16
#endif
const pmf_motions_run_t PMF_MOTIONS_NAME = {PMF_LANES, run_motions};

#ifndef PMF_LANE_BYTES
void pmf_move_all(const pmf_motions_t *motions)
{
    const pmf_motions_run_t *wide = pmf_motions_widest();
    uint64_t first = 0;
    while (first < motions->motions) {
        /* lanes without a motion do not pay for only one or two motions */
        const pmf_motions_run_t *run = motions->motions - first > 1U && wide != 0 ? wide : &pmf_motions_1;
        first = run->run(motions, first);
    }
}
#endif
