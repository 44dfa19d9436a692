// The law of a wave: at which tick its next step (half cycle or chip) begins. Pure, so that it also runs on a host.
//
// A linear sweep's mean step rate between two ticks is exactly the one in the middle. So the steps passed in `t` ticks
// are t * (rate + slope * t / 2), and the next step is where that reaches 1: found by Newton's iteration from the last
// interval, without a division. Rate and slope are exact integers, and what rounding to whole ticks leaves over is
// carried to the next step: nothing drifts. Short steps are found in blocks of up to sixteen and spread evenly, as
// long as that moves them by less than about a tick.
#pragma once

#include <stdint.h>

#include "wave.h"

class Law {
  public:
    // Begins a wave; returns how many ticks it lasts.
    uint32_t begin(const Wave &wave);
    // Ticks from the last step (at first: from the wave's start) to the next one; 0 when the wave ends before it.
    uint16_t next();

  private:
    struct Trial;
    bool begin_block();
    bool find_block();
    void choose_block(uint16_t change_ticks);
    void try_interval(uint16_t ticks, Trial &trial) const;
    static uint16_t improved(uint16_t ticks, int32_t error, bool halfway);
    void pass(uint16_t ticks, const Trial &trial);

    uint32_t rate_;           // steps per tick, 2^-32
    uint16_t rate_fraction_;  // and 2^-48
    int32_t slope_;           // steps per tick squared, 2^-48
    int32_t excess_;          // steps passed beyond the last one, 2^-32
    uint32_t ticks_left_;
    uint8_t block_log2_;      // of the next block's steps
    uint16_t block_ticks_;    // about as long as the next block will be
    uint8_t most_improvements_;
    uint8_t steps_left_, in_block_;  // of the present block
    uint16_t step_ticks_;     // of the present block, rounded down
    uint8_t spare_ticks_;     // what that leaves over, to be spread over the block
    uint8_t spread_;
};
