/* Craft states with valid checksums from a true state: draw fields at random, extremes first, then load and step the
 * state.
 *
 * Compile with the kernel's sources, of the module or of an export, under AddressSanitizer and UBSan. Arguments:
 * folder, number of states, first seed. The folder has three files. `config` is a pmf_config_t, and `state` is a
 * pmf_state_t. `words` are pairs of the offset of a field in the state and 1 for a real number or 0 for a whole number.
 * The program prints the number of accepted states. With FLEET, the states are vectors of a fleet. */
#include "pmf.h"
#ifdef FLEET
#include "many/pmf_many.h"
#endif

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEPS 100
#define MOST_FIELDS 12U
#define MAX_FIELDS 8192

static uint32_t word[2 * MAX_FIELDS], words;
static pmf_config_t config;
static pmf_state_t base, crafted, loaded;
static pmf_saved_t saved;
static uint64_t bits;

static uint32_t drawn(void)
{
    bits ^= bits << 13;
    bits ^= bits >> 7;
    bits ^= bits << 17;
    return (uint32_t)(bits >> 32);
}

static size_t read_file(const char *folder, const char *name, void *memory, size_t size)
{
    char path[1000];
    FILE *file;
    (void)snprintf(path, sizeof path, "%s/%s", folder, name);
    file = fopen(path, "rb");
    if (file == NULL || (size = fread(memory, 1, size, file)) == 0) {
        (void)fprintf(stderr, "no %s\n", path);
        exit(2);
    }
    (void)fclose(file);
    return size;
}

static real_t drawn_real(void)
{
    static const double extreme[] = {0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e300, -1e300, 1e38, -1e38, 1e30, -1e30,
                                     1e15, -1e15, 1e-30, 0.5, 2.0, 1e9, 1.7976931348623157e308, -1.7976931348623157e308};
    uint32_t place = drawn() % (uint32_t)(sizeof extreme / sizeof extreme[0] + 6U);
    volatile double zero = 0.0;
    if (place < sizeof extreme / sizeof extreme[0]) {
        return (real_t)extreme[place];
    }
    switch (place % 6U) {
    case 0U: return (real_t)(1.0 / zero);
    case 1U: return (real_t)(-1.0 / zero);
    case 2U: return (real_t)(zero / zero);
    default: return (real_t)((double)drawn() / 4294967296.0);
    }
}

static uint32_t drawn_whole(void)
{
    static const uint32_t extreme[] = {0U, 1U, 2U, 3U, 7U, 8U, 9U, 99U, 100U, 255U, 65535U, 65536U,
                                       0x7fffffffU, 0x80000000U, 0xfffffffeU, 0xffffffffU};
    uint32_t place = drawn() % (uint32_t)(sizeof extreme / sizeof extreme[0] + 4U);
    if (place < sizeof extreme / sizeof extreme[0]) {
        return extreme[place];
    }
    return place % 2U == 0U ? drawn() : drawn() % 1000U;
}

/* Draw some fields. In one of ten states, draw only fields that were accepted alone: otherwise the kernel would accept
 * hardly any state with many drawn fields. */
static void craft(void)
{
    uint32_t fields = 1U + drawn() % MOST_FIELDS, tries;
    crafted = base;
    for (tries = 0; tries < fields; ++tries) {
        uint32_t at = drawn() % words, here = word[2U * at];
        pmf_state_t before = crafted;
        if (word[2U * at + 1U] != 0U) {
            real_t value = drawn_real();
            memcpy((char *)&crafted + here, &value, sizeof value);
        } else {
            uint32_t value = drawn_whole();
            memcpy((char *)&crafted + here, &value, sizeof value);
        }
        if (drawn() % 16U != 0U && pmf_plausible(&config, &crafted) == 0U) {
            crafted = before;
        }
    }
}

static real_t input_of(uint32_t k)
{
    uint32_t kind = drawn() % 64U;
    return kind == 0U ? drawn_real() : (real_t)(k / 7U % 2U == 0U ? 3.0 : -3.0);
}

static uint32_t count_of(uint32_t count)
{
    return drawn() % 64U == 0U ? drawn_whole() : count + drawn() % 7U - 3U;
}

/* Check that all outputs of an estimate are numbers. */
static void read_all(const pmf_state_t *state)
{
    static real_t p[PMF_MAX_PARAMETERS * PMF_MAX_PARAMETERS];
    uint32_t i;
    pmf_covariance_factor(&config, state, p);
    for (i = 0; i < pmf_parameters(&config); ++i) {
        real_t theta = pmf_estimate(&config, state)->theta[i], variance = pmf_variance(&config, state, i);
        if (!(theta - theta == PMF_R(0.0)) || variance < PMF_R(0.0)) {
            (void)fprintf(stderr, "an estimate of %g with variance %g\n", (double)theta, (double)variance);
            exit(3);
        }
    }
}

#ifdef FLEET
#define AXES 9U

static pmf_layout_t layout;
static unsigned char *packed;
static double result[6][AXES * PMF_MAX_PARAMETERS];
static uint32_t statuses[AXES];

static uint32_t run(void)
{
    static double u[STEPS];
    static int64_t counts[STEPS];
    pmf_many_t many;
    uint32_t k, axis;
    for (k = 0; k < STEPS; ++k) {
        u[k] = (double)input_of(k);
        counts[k] = (int64_t)count_of(k > 0U ? (uint32_t)counts[k - 1U] : 0U);
    }
    memset(&many, 0, sizeof many);
    many.way = pmf_many_way();
    many.input.start = (const unsigned char *)u;
    many.counts.start = (const unsigned char *)counts;
    many.input.sample = many.counts.sample = 8;
    many.input.size = many.counts.size = 8U;
    many.samples = STEPS;
    many.kept = 1U;
    many.theta = result[0];
    many.variance_factor = result[1];
    many.inflation = result[2];
    many.innovation = result[3];
    many.innovation_variance = result[4];
    many.status = statuses;
    pmf_many_run(&config, &layout, &many, 0U, AXES, packed);
    for (axis = 0; axis < AXES; ++axis) { /* the unpacked state can be loaded again, unless it has overflowed */
        pmf_unpack(&layout, packed + axis * layout.packed_size, &loaded);
        read_all(&loaded);
    }
    return 1U;
}

/* Take nine axes at a time: a full vector and a remainder. */
static uint32_t take(uint32_t number)
{
    uint32_t axis = number % AXES;
    if (pmf_plausible(&config, &crafted) == 0U) {
        crafted = base;
    }
    pmf_pack(&layout, &crafted, packed + axis * layout.packed_size);
    return axis == AXES - 1U ? AXES * run() : 0U;
}
#else
static uint32_t take(uint32_t number)
{
    uint32_t k, count = 0U;
    loaded = base;
    pmf_save(&config, &crafted, &saved);
    if (pmf_load(&config, &saved, &loaded) != PMF_LOADED) {
        if (memcmp(&loaded, &base, sizeof base) != 0) {
            (void)fprintf(stderr, "a refused state was taken in part\n");
            exit(4);
        }
        return 0U;
    }
    read_all(&loaded);
    for (k = 0; k < STEPS; ++k) {
        count = count_of(count);
        (void)pmf_step(&config, &loaded, input_of(k), count);
        read_all(&loaded);
        if (k == STEPS / 2U) {
            pmf_open(&config, &loaded, number % (pmf_parameters(&config) + 1U) == 0U ? PMF_NO_PARAMETER : number % pmf_parameters(&config), PMF_R(0.003));
        }
    }
    return 1U;
}
#endif

int main(int argc, char **argv)
{
    uint32_t number, taken = 0U, states;
    if (argc != 4) {
        return 2;
    }
    states = (uint32_t)atoi(argv[2]);
    bits = 88172645463325252U + (uint64_t)atoi(argv[3]);
    (void)read_file(argv[1], "config", &config, sizeof config);
    (void)read_file(argv[1], "state", &base, sizeof base);
    words = (uint32_t)(read_file(argv[1], "words", word, sizeof word) / 8U);
    if (pmf_plausible(&config, &base) == 0U) {
        (void)fprintf(stderr, "the true state is refused\n");
        return 5;
    }
#ifdef FLEET
    (void)read_file(argv[1], "layout", &layout, sizeof layout);
    packed = (unsigned char *)calloc(AXES, layout.packed_size);
#endif
    for (number = 0; number < states; ++number) {
        craft();
        taken += take(number);
    }
#ifdef FLEET
    free(packed);
#endif
    (void)printf("%u %u\n", states, taken);
    return 0;
}
