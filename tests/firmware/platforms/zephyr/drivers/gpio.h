/* What an application sees of Zephyr's pins, on a board that plays a list of events back. */
#ifndef ZEPHYR_GPIO_H
#define ZEPHYR_GPIO_H

#include <zephyr/kernel.h>

struct gpio_dt_spec {
    const struct device *port;
    uint8_t pin;
};
struct gpio_callback {
    void (*handler)(const struct device *port, struct gpio_callback *callback, uint32_t pins);
};

#define DT_ALIAS(alias) PIN_##alias
#define PIN_channel_a 1
#define PIN_channel_b 0
#define GPIO_DT_SPEC_GET(node, property) {NULL, node}
#define GPIO_INPUT 1U
#define GPIO_INT_EDGE_BOTH 2U

static struct gpio_callback *board_callback;

void board_edge(void)
{
    board_callback->handler(NULL, board_callback, 0U);
}

static inline int gpio_pin_get_dt(const struct gpio_dt_spec *pin)
{
    return board_levels >> pin->pin & 1;
}

static inline int gpio_pin_configure_dt(const struct gpio_dt_spec *pin, uint32_t flags)
{
    (void)pin;
    (void)flags;
    return 0;
}

static inline void gpio_init_callback(struct gpio_callback *callback,
                                      void (*handler)(const struct device *, struct gpio_callback *, uint32_t),
                                      uint32_t pins)
{
    (void)pins;
    callback->handler = handler;
}

static inline int gpio_add_callback(const struct device *port, struct gpio_callback *callback)
{
    (void)port;
    board_callback = callback;
    return 0;
}

static inline int gpio_pin_interrupt_configure_dt(const struct gpio_dt_spec *pin, uint32_t flags)
{
    (void)pin;
    (void)flags;
    return 0;
}

#endif
