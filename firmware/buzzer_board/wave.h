// A wave: what one emission plays.
#pragma once

#include <stdint.h>

enum WaveKind : uint8_t { WAVE_SWEEP, WAVE_TONE, WAVE_MLS };

struct Wave {
    WaveKind kind;
    uint8_t order;             // of the shift register (WAVE_MLS only)
    uint32_t start_hz;         // of an MLS: chips a second
    uint32_t stop_hz;          // equal to start_hz but for a sweep
    uint32_t duration_us;
};
