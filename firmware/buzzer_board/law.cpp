#include "law.h"

#include "multiply.h"

#pragma GCC optimize("O2")  // this runs between two edges

namespace {

constexpr uint32_t TICKS_A_SECOND = 2000000;
constexpr uint8_t WHOLE_IMPROVEMENTS = 4, MOST_IMPROVEMENTS = 24;  // sensible sweeps need one or two
constexpr uint16_t BRIEF_TICKS = 256;    // no time for more than one improvement; the next step makes up for it
constexpr uint8_t FEW_IMPROVEMENTS = 1;
constexpr uint16_t SHORT_TICKS = 128, VERY_SHORT_TICKS = 64;  // found in blocks, and in blocks of four at least
constexpr uint8_t LARGEST_BLOCK_LOG2 = 4;
// change from block to block; an eighth of it is the error within
constexpr uint16_t STEADY_TICKS = 2, UNSTEADY_TICKS = 8;

}  // namespace

// Where the wave would be some ticks after the last step.
struct Law::Trial {
    int32_t error;    // of a block, 2^-16
    uint32_t excess;  // steps, 2^-32
    uint32_t change;  // of the rate, 2^-32
    uint16_t change_fraction;
};

uint32_t Law::begin(const Wave &wave) {
    const uint8_t steps_per_cycle = wave.kind == WAVE_MLS ? 1 : 2;  // start_hz of an MLS counts chips
    const uint32_t duration_ticks = wave.duration_us * 2;
    const uint64_t rate = ((uint64_t)(wave.start_hz * steps_per_cycle) << 48) / TICKS_A_SECOND;
    rate_ = (uint32_t)(rate >> 16);
    rate_fraction_ = (uint16_t)rate;
    const bool falls = wave.stop_hz < wave.start_hz;
    const uint32_t span_hz = falls ? wave.start_hz - wave.stop_hz : wave.stop_hz - wave.start_hz;
    const uint64_t per_second = (((uint64_t)(span_hz * steps_per_cycle) << 48) + duration_ticks / 2) / duration_ticks;
    slope_ = (int32_t)((per_second + TICKS_A_SECOND / 2) / TICKS_A_SECOND);
    if (falls) slope_ = -slope_;
    const uint32_t fastest_hz = falls ? wave.start_hz : wave.stop_hz;
    block_ticks_ = (uint16_t)(TICKS_A_SECOND / (fastest_hz * steps_per_cycle));  // Newton is safe from below
    most_improvements_ = MOST_IMPROVEMENTS;
    block_log2_ = 0;
    steps_left_ = 0;
    excess_ = 0;
    ticks_left_ = duration_ticks;
    return duration_ticks;
}

inline void Law::try_interval(uint16_t ticks, Trial &trial) const {
    uint32_t rate = rate_;
    trial.change = 0;
    trial.change_fraction = 0;
    if (slope_) {
        const Product48 change = multiply(ticks, (uint32_t)slope_);
        trial.change = change.high;
        trial.change_fraction = change.low;
        if (slope_ < 0) trial.change -= (uint32_t)ticks << 16;
        rate += (uint32_t)((int32_t)trial.change >> 1);
    }
    const Product48 passed = multiply(ticks, rate);
    const uint32_t fraction = passed.high << 16 | passed.low;
    int16_t steps = (int16_t)(passed.high >> 16) - (int16_t)(1 << block_log2_);
    trial.excess = fraction + (uint32_t)excess_;
    if (excess_ < 0) steps--;
    if (trial.excess < fraction) steps++;  // a carry
    trial.error = (int32_t)((uint32_t)steps << 16 | trial.excess >> 16) >> block_log2_;
}

// Newton's step with 1 / ticks for the derivative, which is right but for sweeps that rise from almost nothing within a
// step: there it is twice as large, and half of Newton's step is the right one.
inline uint16_t Law::improved(uint16_t ticks, int32_t error, bool halfway) {
    if (error > INT16_MAX) return ticks / 2;
    if (error < INT16_MIN) return ticks > UINT16_MAX / 2 ? UINT16_MAX : ticks * 2;
    const int16_t excess_ticks = (int16_t)(((int32_t)(int16_t)error * ticks + 0x8000) >> 16);
    const int16_t correction = halfway ? excess_ticks / 2 : excess_ticks;
    return (uint16_t)(ticks - (uint16_t)correction);
}

inline void Law::pass(uint16_t ticks, const Trial &trial) {
    const uint32_t fraction = (uint32_t)rate_fraction_ + trial.change_fraction;
    rate_fraction_ = (uint16_t)fraction;
    rate_ += trial.change + (uint16_t)(fraction >> 16);
    excess_ = (int32_t)trial.excess;
    ticks_left_ -= ticks;
    block_ticks_ = ticks;
    most_improvements_ = ticks < BRIEF_TICKS ? FEW_IMPROVEMENTS : MOST_IMPROVEMENTS;
}

// Finds how long the next block is; false when the wave ends before the block does.
bool Law::find_block() {
    uint16_t ticks = block_ticks_;
    const uint8_t good_enough = block_log2_ ? 1 : 0;  // ticks; the next block makes up for it
    Trial trial;
    for (uint8_t improvements = 0;; improvements++) {
        const bool reaches_end = ticks >= ticks_left_;
        if (reaches_end) ticks = (uint16_t)ticks_left_;
        try_interval(ticks, trial);
        const uint16_t better = improved(ticks, trial.error, improvements > WHOLE_IMPROVEMENTS);
        if ((uint16_t)(better - ticks + good_enough) <= 2 * good_enough || improvements == most_improvements_) break;
        if (reaches_end && better > ticks) break;
        ticks = better;
    }
    if (ticks >= ticks_left_) return false;
    pass(ticks, trial);
    return true;
}

// Finds the next steps, as many as fit into the wave; false when none does.
bool Law::begin_block() {
    const uint16_t expected_ticks = block_ticks_;
    while (!find_block()) {
        if (!block_log2_) return false;
        block_log2_--;
        block_ticks_ >>= 1;
    }
    steps_left_ = in_block_ = (uint8_t)(1 << block_log2_);
    step_ticks_ = block_ticks_ >> block_log2_;
    spare_ticks_ = (uint8_t)block_ticks_ & (in_block_ - 1);
    spread_ = in_block_ / 2;
    choose_block(block_ticks_ > expected_ticks ? block_ticks_ - expected_ticks : expected_ticks - block_ticks_);
    return true;
}

inline void Law::choose_block(uint16_t change_ticks) {
    const bool is_short = step_ticks_ < SHORT_TICKS;
    const uint8_t least_log2 = step_ticks_ < VERY_SHORT_TICKS ? 2 : 0;
    const bool grows = is_short && change_ticks <= STEADY_TICKS && block_log2_ < LARGEST_BLOCK_LOG2;
    if (grows || block_log2_ < least_log2) {
        block_log2_++;
        block_ticks_ <<= 1;
    } else if (block_log2_ > least_log2 && (!is_short || change_ticks > UNSTEADY_TICKS)) {
        block_log2_--;
        block_ticks_ >>= 1;
    }
}

uint16_t Law::next() {
    if (!steps_left_ && !begin_block()) return 0;
    steps_left_--;
    spread_ += spare_ticks_;
    if (spread_ < in_block_) return step_ticks_;
    spread_ -= in_block_;
    return step_ticks_ + 1;
}
