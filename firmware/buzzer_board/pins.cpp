#include "pins.h"

#include <Arduino.h>

#include "config.h"

namespace {

// A pin as registers, so that an edge costs a few cycles.
struct Pin {
    volatile uint8_t *out, *direction, *in;
    uint8_t mask;

    void choose(uint8_t number) {
        const uint8_t port = digitalPinToPort(number);
        out = portOutputRegister(port);
        direction = portModeRegister(port);
        in = portInputRegister(port);
        mask = digitalPinToBitMask(number);
    }
    __attribute__((always_inline)) void high() const { *out |= mask; }
    __attribute__((always_inline)) void low() const { *out &= (uint8_t)~mask; }
    void drive_low() const {
        low();
        *direction |= mask;
    }
    bool is_held_low() const { return (*direction & mask) && !(*out & mask) && !(*in & mask); }
};

Pin buzzers[N_BUZZERS], led_pin, sync_pin, chosen;

}  // namespace

void pins::begin() {
    for (uint8_t i = 0; i < N_BUZZERS; i++) buzzers[i].choose(BUZZER_PINS[i]);
    led_pin.choose(LED_PIN);
    if (SYNC_PIN != NO_PIN) sync_pin.choose(SYNC_PIN);
    chosen = buzzers[0];
    for (const Pin &buzzer : buzzers) buzzer.drive_low();
    led_pin.drive_low();
    if (SYNC_PIN != NO_PIN) sync_pin.drive_low();
}

void pins::choose(uint8_t buzzer) { chosen = buzzers[buzzer - 1]; }

void pins::level(bool high) {
    if (high) {
        chosen.high();
        if (SYNC_PIN != NO_PIN) sync_pin.high();
    } else {
        chosen.low();
        if (SYNC_PIN != NO_PIN) sync_pin.low();
    }
}

void pins::led(bool on) { on ? led_pin.high() : led_pin.low(); }

void pins::silence() {
    for (const Pin &buzzer : buzzers) buzzer.low();
    if (SYNC_PIN != NO_PIN) sync_pin.low();
    led_pin.low();
}

bool pins::others_are_low(uint8_t sounding) {
    for (uint8_t i = 0; i < N_BUZZERS; i++)
        if (i + 1 != sounding && !buzzers[i].is_held_low()) return false;
    return true;
}
