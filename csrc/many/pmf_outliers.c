/* Counts that no motion explains in a whole record, which pmf_outlier.c judges sample by sample.
 * SPDX-License-Identifier: Apache-2.0 */
#include "pmf_outliers.h"
#include "../pmf_outlier.h"

#include <string.h>

static void accept(pmf_view_t *view, pmf_relative_t count, double time)
{
    memmove(view->count, view->count + 1, (PMF_PAST - 1U) * sizeof *view->count);
    memmove(view->time, view->time + 1, (PMF_PAST - 1U) * sizeof *view->time);
    view->count[PMF_PAST - 1U] = count;
    view->time[PMF_PAST - 1U] = time;
    view->past += view->past < PMF_PAST ? 1U : 0U;
}

/* Judge the samples from the first to the last, or backwards for the last `samples` samples. */
static void judge_all(const pmf_outliers_t *record, uint64_t samples, int back)
{
    pmf_view_t view;
    pmf_verdict_t verdict;
    int64_t zero = 0, moved;
    uint64_t k, last = record->samples - 1U;
    memset(&view, 0, sizeof view);
    view.step = record->step;
    view.slack = record->step;
    view.speed = record->speed;
    for (k = 0; k < samples; ++k) {
        uint64_t place = back ? last - k : k, left = record->samples - k;
        uint32_t i;
        view.readings = left < PMF_VIEW ? (uint32_t)left : PMF_VIEW;
        for (i = 0; i < view.readings; ++i) {
            uint64_t other = back ? place - i : place + i;
            view.count[PMF_PAST + i] = record->count[other] - zero;
            view.time[PMF_PAST + i] = back ? -record->time[other] : record->time[other];
        }
        verdict.verdict = PMF_READING_FITS;
        verdict.count = view.count[PMF_PAST];
        if (pmf_is_smooth(&view) == 0) {
            pmf_judge(&view, &verdict);
        }
        moved = verdict.verdict == PMF_ZERO_MOVED && !back ? view.count[verdict.first] - verdict.end : 0;
        if (verdict.verdict != PMF_READING_FITS) {
            record->wrong[place] = 1U;
            record->moved[place] = moved;
        }
        zero += moved;
        record->count[place] = verdict.count;
        accept(&view, verdict.count, view.time[PMF_PAST]);
    }
}

void pmf_find_outliers(const pmf_outliers_t *record)
{
    memset(record->wrong, 0, record->samples);
    memset(record->moved, 0, record->samples * sizeof *record->moved);
    if (record->samples == 0U) {
        return;
    }
    judge_all(record, record->samples, 0);
    judge_all(record, record->samples < PMF_AHEAD ? record->samples : PMF_AHEAD,
              1); /* the last samples have too few after them */
}
