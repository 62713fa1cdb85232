/* Startup code for a Cortex-M4F or -M7 on the boards mps2-an386 and mps2-an500: vectors, floating-point unit, C
 * library. */
#include <stdint.h>

extern uint32_t stack_top;
void _start(void);
void reset(void);
void halt(void);

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* CPACR: enable coprocessors 10 and 11, the floating-point unit */
    __asm__ volatile("dsb\n isb");
    _start();
}

void halt(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[16] = {
    (uintptr_t)&stack_top, (uintptr_t)reset, (uintptr_t)halt, (uintptr_t)halt,
    (uintptr_t)halt,       (uintptr_t)halt,  (uintptr_t)halt,
};
