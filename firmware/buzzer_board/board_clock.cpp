#include "board_clock.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

volatile uint32_t board_clock::laps;

ISR(TIMER1_OVF_vect) { board_clock::laps = board_clock::laps + 1; }

void board_clock::begin() {
    TIMSK0 = 0;  // Arduino's millisecond interrupt would shift edges, and nothing here asks for milliseconds
    TIMSK1 = 0;
    TCCR1A = 0;
    TCCR1B = _BV(CS11);
    TCNT1 = 0;
    TIFR1 = _BV(TOV1) | _BV(OCF1A) | _BV(OCF1B);
    TIMSK1 = _BV(TOIE1);
}

board_clock::Stamp board_clock::now() {
    Stamp now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = stamp(); }
    return now;
}

bool board_clock::runs() {
    constexpr uint8_t LOOK = 25;  // counts of Timer 0, which Arduino's start-up left running at 4 us each
    const uint8_t start = TCNT0;
    const uint32_t start_ticks = now().total_ticks();
    for (uint16_t patience = 1000; patience && (uint8_t)(TCNT0 - start) < LOOK; patience--) {
    }
    const uint32_t passed = now().total_ticks() - start_ticks;
    return passed > LOOK * 8 / 2 && passed < LOOK * 8 * 2;
}
