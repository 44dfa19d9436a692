// A maximum-length sequence: the bits of a shift register with feedback, which starts with all ones.
#pragma once

#include <stdint.h>

class Mls {
  public:
    void begin(uint8_t order) {
        // Bit n - 1 is stage n. Stages 7,6 / 8,6,5,4 / 9,5 / 10,7 / 11,9 / 12,11,10,4 / 13,12,11,8 are fed back.
        static constexpr uint16_t TAPS[] = {0x60, 0xb8, 0x110, 0x240, 0x500, 0xe08, 0x1c80};
        taps_ = TAPS[order - 7];
        last_stage_ = (uint16_t)(1u << (order - 1));
        stages_ = (uint16_t)(last_stage_ * 2 - 1);
    }

    bool next() {
        const bool out = stages_ & last_stage_;
        stages_ = (uint16_t)(stages_ << 1 | (uint8_t)__builtin_parity(stages_ & taps_));
        return out;
    }

  private:
    uint16_t stages_, taps_, last_stage_;
};
