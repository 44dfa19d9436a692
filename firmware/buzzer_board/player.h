// The player: one emission at a time, every edge from a compare match of Timer 1.
#pragma once

#include <stdint.h>

#include "wave.h"

enum Why : uint8_t { WHY_DONE, WHY_STOP, WHY_LIMIT, WHY_FAULT };

// One emission, as its events tell it.
struct Emission {
    uint8_t buzzer;  // counted from 1
    uint16_t seq;    // of the command
    uint32_t on_us, off_us;
    Why why;
};

namespace player {

void begin();
// Schedules the emission and returns the time of its first edge. Only to be called when idle.
uint32_t play(uint8_t buzzer, const Wave &wave, uint16_t seq);
// Ends the emission, if there is one, at once.
void stop(Why why);
// The buzzer that sounds or is about to; 0 when idle.
uint8_t buzzer();
// Whether an emission began (ended) that was not told yet.
bool began(Emission &emission);
bool ended(Emission &emission);
// Whether the main loop must not rest now: something is to be told, or to be ended.
bool needs_watching();
uint16_t plays();
// What is impossible here and now; 0 when nothing is (see health.h).
uint8_t impossible();

}  // namespace player
