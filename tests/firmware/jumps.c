/* Steps axes whose counters jump several times in a row by up to half of their range, for the sanitizers. */
#include EXPORT_HEADER

static uint64_t bits = 88172645463325252U;

static uint32_t draw(void)
{
    bits ^= bits << 13;
    bits ^= bits >> 7;
    bits ^= bits << 17;
    return (uint32_t)(bits >> 32);
}

static void run(uint32_t first)
{
    pmf_state_t state;
    uint32_t count = 0U, jump = 0U, left = 0U, k, speed = draw() >> (1U + draw() % 30U), mode = draw();
    pmf_init(&EXPORT_CONFIG, &state);
    for (k = 0U; k < 2000U; ++k) {
        count += (k / 40U) % 2U == 0U ? speed : 0U - speed;
        if (left == 0U && k > first && draw() % (mode % 200U + 1U) == 0U) {
            left = 1U + draw() % 5U;
            jump = draw() % 2U == 0U ? 0x80000000U - draw() % 3U : draw();
        }
        if (left > 0U) {
            left -= 1U;
            count += jump;
            jump = (mode & 1U) != 0U ? 0U - jump : jump + draw() % 8U;
        }
        (void)pmf_step(&EXPORT_CONFIG, &state, (k / 40U) % 2U == 0U ? PMF_R(3.0) : PMF_R(-3.0), count);
    }
}

int main(void)
{
    uint32_t k;
    for (k = 0U; k < 3000U; ++k) {
        run(k % 100U);
    }
    return 0;
}
