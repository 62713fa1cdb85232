/* What an application sees of Zephyr's kernel, on a board that plays a list of events back. */
#ifndef ZEPHYR_KERNEL_H
#define ZEPHYR_KERNEL_H

#include <stdio.h>
#include <stdlib.h>

#include "playback.h"

struct device {
    int unused;
};
struct k_timer {
    void (*expired)(struct k_timer *timer);
};
typedef struct {
    uint32_t ticks;
} k_timeout_t;

#define K_USEC(us) ((k_timeout_t){us})
#define K_SECONDS(s) ((k_timeout_t){1000000U * (s)})
#define K_TIMER_DEFINE(name, expiry, stop) static struct k_timer name = {expiry}
#define BIT(n) (1U << (n))

static struct k_timer *board_timer;
void board_edge(void);

static void board_sample(void)
{
    board_timer->expired(board_timer);
}

static inline uint32_t k_cycle_get_32(void)
{
    return board_time;
}

static inline uint32_t sys_clock_hw_cycles_per_sec(void)
{
    return 1000000U;
}

static inline unsigned int irq_lock(void)
{
    return 0U;
}

static inline void irq_unlock(unsigned int key)
{
    (void)key;
}

static inline void k_timer_start(struct k_timer *timer, k_timeout_t duration, k_timeout_t period)
{
    (void)duration;
    (void)period;
    board_timer = timer;
}

/* Everything happens in the first sleep, and the second one ends the program. */
static inline void k_sleep(k_timeout_t timeout)
{
    static int slept;
    (void)timeout;
    if (slept++ != 0) {
        exit(0);
    }
    play(board_edge, board_sample);
}

#endif
