/* Replay a file of samples and write the alarm after each sample: -1, 0 or 1, and the two sums. */
#include EXPORT_HEADER

#include "input.h"

#include <stdio.h>

typedef struct {
    int32_t alarm;
    real_t up, down;
} output_t;

static axis_t axis;

int main(int argc, char **argv)
{
    axis_alarm_t sums[AXIS_ALARMS] = {{PMF_R(0.0), PMF_R(0.0), 0U}};
    input_t input;
    output_t out;
    FILE *from = fopen(argv[1], "rb"), *to = fopen(argv[2], "wb");
    if (argc != 3 || from == NULL || to == NULL) {
        return 2;
    }
    pmf_clear(&out, (uint32_t)sizeof out);
    axis_init(&axis);
    while (fread(&input, sizeof input, 1, from) == 1U) {
        (void)axis_step(&axis, input.u, input.count AGE);
        out.alarm = axis_watch(&axis, sums, 0U);
        out.up = sums[0].up;
        out.down = sums[0].down;
        (void)fwrite(&out, sizeof out, 1, to);
    }
    (void)fclose(from);
    return fclose(to) == 0 ? 0 : 3;
}
