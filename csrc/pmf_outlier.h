/* One count that no motion explains, found without any memory of the motion. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_OUTLIER_H
#define PMF_OUTLIER_H

#include "pmf.h"

/* Whole counts relative to a zero of the caller. Their differences must not overflow. */
#ifdef PMF_FLOAT32
typedef int32_t pmf_relative_t;
#else
typedef int64_t pmf_relative_t;
#endif

/* Counts and times [sample periods], oldest first: `past` accepted counts up to PMF_PAST - 1, then `readings` counts
 * from the judged reading at PMF_PAST on. */
typedef struct {
    pmf_relative_t count[PMF_PAST + PMF_VIEW];
    scalar_t time[PMF_PAST + PMF_VIEW];
    uint32_t past, readings;
    scalar_t step; /* size of the rounding error, at least the encoder's step [counts] */
    scalar_t speed, slack; /* largest change of the counts in a time t: speed t + slack; speed 0: no limit */
} pmf_view_t;

enum pmf_reading { PMF_READING_FITS = 0, PMF_READING_WRONG, PMF_ZERO_MOVED };

/* `count` is the count of the motion, relative like the view. With `unsure` (0 or 1) it may be wrong. If the zero
 * moved, all counts from `first` on belong to the new zero, and the count at `first` would have been `end` with the
 * earlier one. */
typedef struct {
    uint32_t verdict, first, unsure;
    pmf_relative_t count, end;
} pmf_verdict_t;

/* Return 1 if the reading at PMF_PAST needs no verdict: it continues the accepted counts, or the motion around it is as
 * smooth as the motion before and after, or the acceleration around it lasts. Otherwise, return 0. Among the first
 * counts, only an acceleration that lasts is proof. A wrong reading shows accelerations of both signs. */
int pmf_is_smooth(const pmf_view_t *view);
/* Judge the reading at PMF_PAST. */
void pmf_judge(const pmf_view_t *view, pmf_verdict_t *verdict);

#endif
