/* A board whose time, pins and calls follow a list of events: levels of the encoder's channels, and samples. */
#ifndef PLAYBACK_H
#define PLAYBACK_H

#include <stdint.h>

#include "events.h" /* moment_t and `moments` */

#define MOMENTS (sizeof moments / sizeof moments[0])

static uint32_t board_time; /* [us] */
static uint8_t board_levels; /* of A and B as bits */
static float board_input;

/* Play everything back: `edge` is called after each change of a level, and `sample` at each sample. */
static void play(void (*edge)(void), void (*sample)(void))
{
    uint32_t k;
    for (k = 0; k < MOMENTS; ++k) {
        board_time = moments[k].time;
        if (moments[k].sample != 0U) {
            board_input = moments[k].u;
            sample();
        } else {
            board_levels = moments[k].levels;
            edge();
        }
    }
}

#endif
