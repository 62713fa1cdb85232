/* Any sample in any state that pmf_plausible() admits, for Frama-C's analysis of values (docs/proof.py).
 * SPDX-License-Identifier: Apache-2.0 */
#include "axis.h"

#include "__fc_builtin.h"
#include "pmf_internal.h"

/* Numbers of the state whose bounds the proof needs, with their largest values. */
#ifdef PMF_WITH_EDGES
#define GUARDED(BOUND)
#define DELAYED(BOUND) BOUND(edge.start.marks, PMF_MARKS) BOUND(edge.line_number, PMF_MAX_LINES - 1U)
#define STEP(input, count, real) pmf_step(&axis_config, &axis, input, count, real)
#else
#define STEP(input, count, real) pmf_step(&axis_config, &axis, input, count)
#if PMF_WITH_GUARD
#define GUARDED(BOUND) BOUND(guard.past, PMF_PAST) BOUND(guard.readings, PMF_AHEAD)
#else
#define GUARDED(BOUND)
#endif
#if PMF_WITH_DEAD_TIME
#define DELAYED(BOUND) BOUND(late.at, PMF_MAX_LATE - 1U)
#else
#define DELAYED(BOUND)
#endif
#endif

static axis_t axis;

static uint32_t any_between(uint32_t least, uint32_t most)
{
    return Frama_C_unsigned_int_interval(least, most);
}

static real_t any_real(void)
{
    real_t real;
    Frama_C_make_unknown((char *)&real, sizeof real);
    return real;
}

static void make_any_state(void)
{
    Frama_C_make_unknown((char *)&axis, sizeof axis);
}

static void expect_refusal(uint32_t plausible)
{
    /*@ assert refused: plausible == 0; */
    (void)plausible;
}

#define REFUSED(member, most)                           \
    make_any_state();                                   \
    axis.member = any_between((most) + 1U, UINT32_MAX); \
    expect_refusal(pmf_plausible(&axis_config, &axis));
#define ADMITTED(member, most) axis.member = any_between(0U, most);

void prove_refusals(void)
{
    GUARDED(REFUSED)
    DELAYED(REFUSED)
}

void prove_step(void)
{
    make_any_state();
    GUARDED(ADMITTED)
    DELAYED(ADMITTED)
#if !defined(PMF_WITH_EDGES) && PMF_WITH_STEPS
    pmf_set_step(&axis_config, &axis, any_real());
#endif
    (void)STEP(any_real(), any_between(0U, UINT32_MAX), any_real());
}
