/* SPDX-License-Identifier: Apache-2.0 */
#include "ticks.h"
#include <math.h>

int pmf_ticks_run(const pmf_body *body, const pmf_firmware *loop, double *theta, int n, const double *goal,
                  const double *step, double *path, double *work)
{
    const int end = 1;
    double *x = theta + PMF_BODY_X0, *v = theta + PMF_BODY_V0, force, slow = 0, sum = 0;
    double before = loop->resolution * rint(*x / loop->resolution);
    pmf_body part = *body;
    part.n = part.rows = 1, part.row = &end, part.u = &force, part.tick = 0, part.on = 0;
    for (int k = 0; k < n; k++) {
        const double seen = loop->resolution * rint(*x / loop->resolution), apart = goal[k] - seen;
        path[2 * k] = *x, path[2 * k + 1] = *v;
        slow += loop->share * ((seen - before) / loop->period - slow);
        sum += loop->period * apart;
        force = loop->gain * apart + loop->integral * sum - loop->derivative * slow - loop->tacho * *v;
        force = force > loop->limit ? loop->limit : force < -loop->limit ? -loop->limit : force;
        before = seen;
        part.step = step + k;
        if (step[k] > 0 && pmf_body_run(&part, theta, x, v, 0, work) != 1)
            return k;
    }
    return n;
}
