// The firmware with a fault built in, for the tests of its guards. BROKEN names the fault.
#include <Arduino.h>
#include <avr/interrupt.h>

#define loop healthy_loop
#include "buzzer_board.ino"
#undef loop
#include "config.h"
#include "wave.h"

extern uint8_t _end;

namespace {

// An emission, as if the protocol had let it through.
void play_for_us(uint32_t duration_us) { player::play(1, Wave{WAVE_TONE, 0, 1000, 1000, duration_us}, 7); }

bool is_sounding() { return digitalRead(LED_PIN); }

void hang() {  // the main loop alone
    for (;;) {
    }
}

void freeze() {  // with interrupts off, so that no guard but the watchdog's hardware is left
    cli();
    hang();
}

void short_circuit() { digitalWrite(BUZZER_PINS[4], HIGH); }  // a second buzzer

void lose_end() { TIMSK1 &= (uint8_t)~_BV(OCIE1B); }

void lose_edges() { OCR1A -= 3000; }

void overflow_stack() { (&_end)[20] = 0; }

void overrun() { play_for_us(2000000); }

void cancel() {  // before the first edge: no host is quick enough for that
    play_for_us(100000);
    player::stop(WHY_STOP);
}

// As scheduling an emission does, with a lap of the timer that ends just then: no fault, but libsimavr once made it one.
void clear_matches_at_lap() {
    cli();
    while (!(TIFR1 & _BV(TOV1))) {
    }
    TIFR1 = _BV(OCF1A) | _BV(OCF1B);
    sei();
}

}  // namespace

void loop() {
    void (*const fault)() = BROKEN;
    const bool breaks_silence = fault == overrun || fault == cancel || fault == clear_matches_at_lap;
    static bool is_broken;
    healthy_loop();
    if (is_broken || is_sounding() == breaks_silence) return;
    is_broken = true;
    fault();
}
