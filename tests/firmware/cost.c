/* Count the instructions of pmf_step on an emulated Cortex-M. Each instruction advances its clock by 64 ns (-icount
 * shift=6), and SysTick counts every 40 ns. The program prints the mean and the largest number over the samples of the
 * self-test. */
#include EXPORT_HEADER

#include <stdio.h>

#include "selftest_data.h"

#define SAMPLES ((uint32_t)(sizeof sample / sizeof sample[0]))
#define SYST_CSR (*(volatile uint32_t *)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018U)

static pmf_state_t axis;

#ifdef PMF_WITH_EDGES
#define AGE_ARGUMENT , real_t age
#define AGE(k) , sample[k].age
#else
#define AGE_ARGUMENT
#define AGE(k)
#endif
typedef uint32_t step_t(const pmf_config_t *config, pmf_state_t *state, real_t u, uint32_t count AGE_ARGUMENT);

/* The same call as pmf_step, with an empty body: its cost is subtracted. */
__attribute__((noinline)) static uint32_t nothing(const pmf_config_t *config, pmf_state_t *state, real_t u,
                                                  uint32_t count AGE_ARGUMENT)
{
    (void)config;
    (void)state;
    (void)u;
#ifdef PMF_WITH_EDGES
    (void)age;
#endif
    __asm__ volatile("" ::: "memory");
    return count;
}

static uint32_t ticks_of(step_t *step, uint32_t k)
{
    uint32_t start = SYST_CVR;
    (void)step(&EXPORT_CONFIG, &axis, sample[k].u, sample[k].count AGE(k));
    return (start - SYST_CVR) & 0xFFFFFFU;
}

int main(void)
{
    uint32_t k, base, ticks, largest = 0U, sum = 0U;
    SYST_RVR = 0xFFFFFFU;
    SYST_CVR = 0U;
    SYST_CSR = 5U;
    pmf_init(&EXPORT_CONFIG, &axis);
    (void)ticks_of(nothing, 0U);
    base = ticks_of(nothing, 0U);
    for (k = 0U; k < SAMPLES; ++k) {
        ticks = ticks_of(pmf_step, k) - base;
        sum += ticks;
        largest = ticks > largest ? ticks : largest;
    }
    printf("%lu %lu %lu\n", (unsigned long)(10U * (sum / 16U) / SAMPLES), (unsigned long)(largest * 10U / 16U),
           (unsigned long)(base * 10U / 16U));
    return 0;
}
