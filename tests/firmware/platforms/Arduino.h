/* What a sketch sees of Arduino, on a board that plays a list of events back. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stdio.h>

#include "playback.h"

#define CHANGE 1
#define INPUT_PULLUP 2
#define digitalPinToInterrupt(pin) (pin)

struct Port {
    void begin(long) {}
    void println(const char *text) { puts(text); }
    void println(double value, int digits) { printf("%.*f\n", digits, value); }
};
static Port Serial;
static void (*interrupt_of_edge)(void);

static inline uint32_t micros() { return board_time; }
static inline void delay(uint32_t) {}
static inline void noInterrupts() {}
static inline void interrupts() {}
static inline void pinMode(uint8_t, uint8_t) {}
static inline int digitalRead(uint8_t pin) { return pin == 2 ? board_levels >> 1 & 1 : board_levels & 1; }
static inline void attachInterrupt(uint8_t, void (*handler)(void), int) { interrupt_of_edge = handler; }

void setup();
void loop();

int main()
{
    setup();
    play(interrupt_of_edge, loop);
    return 0;
}

#endif
