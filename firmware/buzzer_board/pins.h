// The pins: at most one buzzer is ever driven, and the LED with it.
#pragma once

#include <stdint.h>

namespace pins {

void begin();
// Chooses the buzzer (counted from 1) that `level` drives.
void choose(uint8_t buzzer);
void level(bool high);  // of the chosen buzzer and of the sync output
void led(bool on);
void silence();  // everything low; safe from anywhere
// False when a buzzer other than `sounding` (0: none) is not held low.
bool others_are_low(uint8_t sounding);

}  // namespace pins
