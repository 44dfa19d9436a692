// The board's clock: Timer 1, free-running in ticks of half a microsecond and never stopped or set.
#pragma once

#include <avr/io.h>
#include <stdint.h>

namespace board_clock {

constexpr uint32_t TICKS_PER_US = 2;

// A moment, as it can be read within a few cycles.
struct Stamp {
    uint32_t laps;
    uint16_t ticks;

    uint32_t total_ticks() const { return laps << 16 | ticks; }      // modulo 2^32
    uint32_t us() const { return (laps << 15) + (ticks >> 1); }      // since the board's start, modulo 2^32
};

extern volatile uint32_t laps;

// Now. To be called with interrupts off.
inline __attribute__((always_inline)) Stamp stamp() {
    Stamp now = {laps, TCNT1};
    const bool lap_is_new = TIFR1 & _BV(TOV1);
    if (lap_is_new && now.ticks < 0x8000) now.laps++;
    return now;
}

void begin();
Stamp now();
// Whether it keeps pace with Timer 0, by a look of 0.1 ms.
bool runs();

}  // namespace board_clock
