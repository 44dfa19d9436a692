#include "health.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>

#include "pins.h"

extern uint8_t _end;  // of the variables: the stack grows down towards it

namespace {

constexpr uint16_t ALIVE = 0x5aa7, HUNG = 0xa55b;
constexpr uint8_t UNTOUCHED = 0xc5;

// Outlives a reset. Boot loaders clear MCUSR, so this tells what it cannot.
uint16_t mark __attribute__((section(".noinit")));
uint8_t reset_flags __attribute__((section(".noinit")));
Reset reset;

// After a watchdog reset the watchdog still runs, at its shortest time: stop it before anything else.
void keep_reset_flags() __attribute__((naked, used, section(".init3")));
void keep_reset_flags() {
    reset_flags = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

void paint_memory() {
    const uint8_t *stack = (const uint8_t *)SP - 16;
    for (uint8_t *byte = &_end; byte < stack; byte++) *byte = UNTOUCHED;
}

Reset reset_cause() {
    if (mark == HUNG || (reset_flags & _BV(WDRF))) return RESET_WATCHDOG;
    if (reset_flags & _BV(PORF)) return RESET_POWER;
    if (reset_flags & _BV(BORF)) return RESET_BROWNOUT;
    return mark == ALIVE || (reset_flags & _BV(EXTRF)) ? RESET_EXTERNAL : RESET_POWER;
}

}  // namespace

// The main loop hangs: silence now. The next time-out resets the board.
ISR(WDT_vect) {
    TIMSK1 = 0;
    pins::silence();
    mark = HUNG;
    for (;;) {
    }
}

void health::begin() {
    paint_memory();
    reset = reset_cause();
    mark = ALIVE;
    cli();
    wdt_reset();
    WDTCSR = _BV(WDCE) | _BV(WDE);
    WDTCSR = _BV(WDIE) | _BV(WDE) | _BV(WDP1) | _BV(WDP0);  // interrupt after 0.125 s, reset after another
    sei();
}

void health::alive() { wdt_reset(); }

Reset health::last_reset() { return reset; }

uint16_t health::unused_memory(uint16_t most) {
    uint16_t unused = 0;
    while (unused < most && (&_end)[unused] == UNTOUCHED) unused++;
    return unused;
}
