/* libFuzzer target: every byte string is a run of samples, and after each sample the state must be finite.
 *
 * Compile in an exported folder with clang -std=c99 -ffp-contract=off -O2 -fsanitize=fuzzer,undefined
 * -fno-sanitize-recover. */
#include EXPORT_HEADER

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#define SAMPLE 6U

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerInitialize(int *argc, char ***argv);

static unsigned long long steps;

static void report(void)
{
    (void)fprintf(stderr, "steps: %llu\n", steps);
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    (void)argc;
    (void)argv;
    return atexit(report);
}

/* Return a number that is not finite, large, small, or ordinary. */
static real_t input_of(uint8_t kind, uint8_t value)
{
    volatile real_t zero = PMF_R(0.0);
    real_t level = (real_t)(int8_t)value;
    switch (kind & 15U) {
    case 0U: return zero / zero;
    case 1U: return level / zero;
    case 2U: return level * PMF_R(1e30);
    case 3U: return level * PMF_R(1e36);
    case 4U: return level * PMF_R(1e-40);
    case 5U: return level * PMF_R(1e6);
    case 6U: return PMF_R(0.0);
    default: return level * PMF_R(0.05);
    }
}

/* Return the count after a jump over the whole range, no motion, or some counts. */
static uint32_t count_of(uint8_t kind, const uint8_t *value, uint32_t count)
{
    uint32_t low = value[0], high = value[1];
    switch (kind >> 5U) {
    case 0U: return (low << 24U) | (high << 16U) | (high << 8U) | low;
    case 1U: return count;
    case 2U: return count + 0x80000000U;
    case 3U: return count + (low << 8U);
    default: return count + (uint32_t)((int32_t)(int8_t)value[0]);
    }
}

static int is_finite(const real_t *number, size_t n)
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (!(number[i] - number[i] == PMF_R(0.0))) {
            return 0;
        }
    }
    return 1;
}

#define FINITE(array) is_finite((const real_t *)(const void *)&(array), sizeof(array) / sizeof(real_t))

static int is_recursion_finite(const pmf_recursion_state_t *state)
{
    return FINITE(state->sums) && FINITE(state->peak) && FINITE(state->factor) && FINITE(state->inverse_pivot) &&
           FINITE(state->estimate) && FINITE(state->mass) && FINITE(state->weight) &&
           FINITE(state->innovation_square) && FINITE(state->score);
}

static int is_state_finite(const pmf_state_t *state)
{
    int fine = FINITE(state->network.memory) && is_recursion_finite(&state->direct) && FINITE(state->encoder.velocity) &&
               FINITE(state->encoder.position) && FINITE(state->encoder.input) && FINITE(state->encoder.mean_velocity);
#if PMF_WITH_AUXILIARY
    fine = fine && is_recursion_finite(&state->instrument) && FINITE(state->auxiliary.parameter) &&
           FINITE(state->auxiliary.velocity) && FINITE(state->auxiliary.position) && FINITE(state->output);
#endif
    return fine;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    pmf_state_t state;
    uint32_t count = 0U, repeat;
    size_t k;
    pmf_init(&EXPORT_CONFIG, &state);
    for (k = 0; k + SAMPLE <= size; k += SAMPLE) {
        for (repeat = 0U; repeat <= data[k + 4U]; ++repeat) { /* repeated samples let the filters settle */
            count = count_of(repeat == 0U ? data[k] : data[k + 5U], &data[k + 2U], count);
            ++steps;
            (void)pmf_step(&EXPORT_CONFIG, &state, input_of(data[k], data[k + 1U]), count);
            if (!FINITE(pmf_estimate(&EXPORT_CONFIG, &state)->theta)) {
                __builtin_trap();
            }
        }
        if (!is_state_finite(&state)) {
            __builtin_trap();
        }
    }
    return 0;
}

#ifdef RANDOM_STEPS /* without libFuzzer: feed random bytes until the given number of steps is done */
int main(void)
{
    static uint8_t data[600];
    uint64_t bits = 88172645463325252U;
    size_t i;
    while (steps < RANDOM_STEPS) {
        for (i = 0; i < sizeof data; ++i) {
            bits ^= bits << 13;
            bits ^= bits >> 7;
            bits ^= bits << 17;
            data[i] = (uint8_t)(bits >> 32);
        }
        (void)LLVMFuzzerTestOneInput(data, sizeof data);
    }
    report();
    return 0;
}
#endif
