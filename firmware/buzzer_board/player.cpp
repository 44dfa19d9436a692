#include "player.h"

#include <avr/cpufunc.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board_clock.h"
#include "config.h"
#include "health.h"
#include "law.h"
#include "mls.h"
#include "pins.h"

namespace {

constexpr uint32_t LIMIT_TICKS = MAX_DURATION_US * board_clock::TICKS_PER_US;
constexpr uint16_t LEAD_TICKS = 2000;   // from scheduling to the first edge
constexpr uint16_t CLOSE_TICKS = 200;   // longer than scheduling takes
constexpr uint16_t LATENCY_TICKS = 7;   // from a compare match to the pin; edges are scheduled earlier by this
constexpr uint16_t LONGEST_STEP_TICKS = 20000 + 200;  // half a cycle at 50 Hz, and some slack
constexpr uint32_t SLACK_TICKS = 2000;

enum State : uint8_t { IDLE, ARMED, SOUNDING, OVER };

volatile State state = IDLE;
bool on_is_told;
Emission emission;
Law law;
Mls mls;
bool is_mls, is_cut;
uint32_t start_ticks, length_ticks;
uint8_t laps_left;  // of the timer, until the end
uint16_t n_plays;

// The steps to come: worked out ahead, for now and then one takes longer than the time between two edges.
// Each is the ticks since the one before, and the level it goes to.
constexpr uint16_t LEVEL = 0x8000;
constexpr uint8_t N_STEPS = 32;  // a power of two
volatile uint16_t steps[N_STEPS];
volatile uint8_t n_made, n_taken;
volatile bool is_making, is_last_made, ran_dry;
bool level, made_level;

// With interrupts off.
void finish(uint32_t elapsed_ticks, Why why) {
    TIMSK1 &= (uint8_t) ~(_BV(OCIE1A) | _BV(OCIE1B));
    pins::silence();
    emission.off_us = emission.on_us + elapsed_ticks / board_clock::TICKS_PER_US;
    emission.why = why;
    _MemoryBarrier();
    state = OVER;
}

// With interrupts off.
void schedule() {
    const board_clock::Stamp now = board_clock::stamp();
    const uint32_t now_ticks = now.total_ticks() & ~1ul;  // the ticks of the microsecond that the stamp tells
    uint16_t lead_ticks = LEAD_TICKS;
    uint16_t first_lap_ticks = (uint16_t)(lead_ticks + length_ticks - LATENCY_TICKS);
    if (first_lap_ticks < CLOSE_TICKS) {  // the guard might match, or not, while it is being set
        lead_ticks += CLOSE_TICKS;
        first_lap_ticks += CLOSE_TICKS;
    }
    laps_left = (uint8_t)((lead_ticks + length_ticks - LATENCY_TICKS - first_lap_ticks) >> 16);
    start_ticks = now_ticks + lead_ticks;
    emission.on_us = now.us() + lead_ticks / board_clock::TICKS_PER_US;
    OCR1A = (uint16_t)start_ticks - LATENCY_TICKS;
    OCR1B = (uint16_t)now_ticks + first_lap_ticks;
    TIFR1 = _BV(OCF1A) | _BV(OCF1B);
    TIMSK1 |= _BV(OCIE1A) | _BV(OCIE1B);
    state = ARMED;
}

__attribute__((noinline)) void make_steps() {
    for (uint8_t made = n_made; (uint8_t)(made - n_taken) < N_STEPS; n_made = ++made) {
        const uint16_t ticks = law.next();
        is_last_made = !ticks;
        if (!ticks) return;
        made_level = is_mls ? mls.next() : !made_level;
        steps[made % N_STEPS] = made_level ? ticks | LEVEL : ticks;
    }
}

}  // namespace

// A step: the pin first, so that the latency is the same every time. Then the steps to come, with interrupts on again:
// this one may well interrupt itself.
ISR(TIMER1_COMPA_vect) {
    pins::level(level);
    if (state == ARMED) {
        pins::led(true);
        state = SOUNDING;
    }
    if (n_taken == n_made) {
        TIMSK1 &= (uint8_t)~_BV(OCIE1A);
        ran_dry = !is_last_made;
        return;
    }
    const uint8_t taken = n_taken;
    const uint16_t step = steps[taken % N_STEPS];
    OCR1A += step & ~LEVEL;
    level = step & LEVEL;
    n_taken = taken + 1;
    if (is_making || is_last_made || (uint8_t)(n_made - taken) > N_STEPS - 8) return;
    is_making = true;
    sei();
    make_steps();
    cli();
    is_making = false;
}

// The end, a guard that knows nothing of steps: it matches once a lap of the timer, and lets steps go first.
ISR(TIMER1_COMPB_vect, ISR_NOBLOCK) {
    if (laps_left) {
        laps_left--;
        return;
    }
    cli();
    finish(length_ticks, is_cut ? WHY_LIMIT : WHY_DONE);
}

void player::begin() { pins::begin(); }

uint32_t player::play(uint8_t buzzer, const Wave &wave, uint16_t seq) {
    is_mls = wave.kind == WAVE_MLS;
    if (is_mls) mls.begin(wave.order);
    level = made_level = is_mls ? mls.next() : true;
    length_ticks = law.begin(wave);
    is_cut = length_ticks > LIMIT_TICKS;
    if (is_cut) length_ticks = LIMIT_TICKS;
    n_made = n_taken = 0;
    is_last_made = ran_dry = false;
    make_steps();
    emission = {buzzer, seq, 0, 0, WHY_DONE};
    n_plays++;
    pins::choose(buzzer);
    on_is_told = false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { schedule(); }
    return emission.on_us;
}

void player::stop(Why why) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (state == ARMED) {
            finish(0, why);
            state = IDLE;  // it never began, so nothing is told
        } else if (state == SOUNDING) {
            finish(board_clock::stamp().total_ticks() - start_ticks, why);
        }
    }
}

uint8_t player::buzzer() { return state == ARMED || state == SOUNDING ? emission.buzzer : 0; }

bool player::began(Emission &told) {
    if (on_is_told || state == IDLE || state == ARMED) return false;
    _MemoryBarrier();
    on_is_told = true;
    told = emission;
    return true;
}

bool player::ended(Emission &told) {
    if (state != OVER || !on_is_told) return false;
    _MemoryBarrier();  // an interrupt wrote the rest before `state`
    told = emission;
    state = IDLE;
    return true;
}

bool player::needs_watching() {
    const bool is_last_step_out = !(TIMSK1 & _BV(OCIE1A));  // then nothing but the end would wake the board
    return state == OVER || (state == SOUNDING && (is_last_step_out || !on_is_told));
}

uint16_t player::plays() { return n_plays; }

uint8_t player::impossible() {
    if (!pins::others_are_low(buzzer())) return FAULT_PIN;
    if (state != ARMED && state != SOUNDING) return FAULT_NONE;
    if (ran_dry) return FAULT_TIMER;
    const uint32_t since_end_ticks = board_clock::now().total_ticks() - start_ticks - length_ticks;
    if ((int32_t)since_end_ticks > (int32_t)SLACK_TICKS) return FAULT_TIMER;
    uint16_t ahead_ticks;
    bool waits;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        ahead_ticks = OCR1A - TCNT1;
        // read after the timer: a match in between is no fault
        waits = (TIMSK1 & _BV(OCIE1A)) && !(TIFR1 & _BV(OCF1A));
    }
    return waits && ahead_ticks > LONGEST_STEP_TICKS ? FAULT_TIMER : FAULT_NONE;
}
