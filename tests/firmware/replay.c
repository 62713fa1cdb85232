/* Replay a file of samples through an export; write the output of each sample, then the state. Compile with
 * -DEXPORT_HEADER='"NAME.h"' -DEXPORT_CONFIG=NAME_config. The option -DGAPS=400,900 names the samples before which
 * samples were lost. */
#include EXPORT_HEADER

#include "input.h"

#include <stdio.h>

#define BLOCK 512

#ifdef PMF_WITH_EDGES
typedef struct {
    uint32_t status;
    real_t theta[PMF_BODY], variance[PMF_BODY], innovation;
} output_t;
#else
typedef struct {
    uint32_t status;
    real_t theta[PMF_MAX_PARAMETERS], variance_factor[PMF_MAX_PARAMETERS], inflation[PMF_MAX_PARAMETERS];
    real_t innovation, innovation_variance;
} output_t;
#endif

static pmf_state_t axis;
static input_t input[BLOCK];
static output_t output[BLOCK];

#ifdef GAPS
static const size_t gaps[] = {GAPS};

static void gap(size_t sample, uint32_t count)
{
    size_t i;
    for (i = 0; i < sizeof gaps / sizeof gaps[0]; ++i) {
        if (gaps[i] == sample) {
            pmf_gap(&EXPORT_CONFIG, &axis, count);
        }
    }
}
#endif

#ifdef PMF_WITH_EDGES
static void step(const input_t *in, output_t *out)
{
    uint32_t i;
    out->status = pmf_step(&EXPORT_CONFIG, &axis, in->u, in->count, in->age);
    for (i = 0; i < PMF_BODY; ++i) {
        out->theta[i] = pmf_estimate(&EXPORT_CONFIG, &axis)->theta[i];
        out->variance[i] = pmf_variance(&EXPORT_CONFIG, &axis, i);
    }
    out->innovation = pmf_estimate(&EXPORT_CONFIG, &axis)->innovation;
}
#else
static void step(const input_t *in, output_t *out)
{
    const pmf_estimate_t *estimate;
    uint32_t i;
#if PMF_WITH_STEPS
    pmf_set_step(&EXPORT_CONFIG, &axis, in->step);
#endif
    out->status = pmf_step(&EXPORT_CONFIG, &axis, in->u, in->count);
    estimate = pmf_estimate(&EXPORT_CONFIG, &axis);
    for (i = 0; i < pmf_parameters(&EXPORT_CONFIG); ++i) {
        out->theta[i] = estimate->theta[i];
        out->variance_factor[i] = estimate->variance_factor[i];
        out->inflation[i] = estimate->inflation[i];
    }
    out->innovation = estimate->innovation;
    out->innovation_variance = estimate->innovation_variance;
}
#endif

int main(int argc, char **argv)
{
    FILE *in, *out;
    size_t n, k;
#ifdef GAPS
    size_t sample = 0;
#endif
    if (argc != 3 || pmf_arithmetic() != 0U) {
        return 2;
    }
    in = fopen(argv[1], "rb");
    out = fopen(argv[2], "wb");
    if (in == NULL || out == NULL) {
        return 3;
    }
    pmf_init(&EXPORT_CONFIG, &axis);
    while ((n = fread(input, sizeof input[0], BLOCK, in)) > 0U) {
        for (k = 0; k < n; ++k) {
#ifdef GAPS
            gap(sample++, input[k].count);
#endif
            step(&input[k], &output[k]);
        }
        if (fwrite(output, sizeof output[0], n, out) != n) {
            return 4;
        }
    }
    (void)fwrite(&axis, sizeof axis, 1, out);
    (void)fclose(in);
    return fclose(out) == 0 ? 0 : 5;
}
