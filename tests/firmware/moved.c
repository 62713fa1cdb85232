/* Resume from a saved state, if one is given, and process a file of samples. Write theta after each sample, then the
 * saved state. Usage: moved SAMPLES STATE THETA SAVED, where STATE "-" means no state. */
#include EXPORT_HEADER

#include "input.h"

#include <stdio.h>

#ifdef PMF_WITH_EDGES
#define PARAMETERS PMF_BODY
#else
#define PARAMETERS pmf_parameters(&EXPORT_CONFIG)
#endif

static pmf_state_t axis;
static pmf_saved_t saved;

static int resume(const char *name)
{
    FILE *file;
    size_t n;
    pmf_init(&EXPORT_CONFIG, &axis);
    if (name[0] == '-') {
        return 1;
    }
    file = fopen(name, "rb");
    if (file == NULL) {
        return 0;
    }
    n = fread(&saved, sizeof saved, 1, file);
    (void)fclose(file);
    return n == 1U && pmf_load(&EXPORT_CONFIG, &saved, &axis) == PMF_LOADED;
}

int main(int argc, char **argv)
{
    FILE *in, *theta, *out;
    input_t input;
    if (argc != 5 || pmf_arithmetic() != 0U || !resume(argv[2])) {
        return 2;
    }
    in = fopen(argv[1], "rb");
    theta = fopen(argv[3], "wb");
    out = fopen(argv[4], "wb");
    if (in == NULL || theta == NULL || out == NULL) {
        return 3;
    }
    while (fread(&input, sizeof input, 1, in) == 1U) {
        (void)pmf_step(&EXPORT_CONFIG, &axis, input.u, input.count AGE);
        (void)fwrite(pmf_estimate(&EXPORT_CONFIG, &axis)->theta, sizeof(real_t), PARAMETERS, theta);
    }
    pmf_save(&EXPORT_CONFIG, &axis, &saved);
    (void)fwrite(&saved, sizeof saved, 1, out);
    return fclose(theta) == 0 && fclose(out) == 0 ? 0 : 4;
}
