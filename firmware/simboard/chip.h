// The chip: libsimavr's AVR with images in its flash, and its resets.
#pragma once

#include <stdbool.h>

#include "sim_avr.h"

// Makes the chip and loads the images (.elf or .hex); one that lies above address 0 is a boot loader and starts first.
avr_t *chip_make(const char *mcu, char *const images[], int n_images);
void chip_power_on(void);
void chip_external_reset(void);
// Runs for about this many cycles; false when the firmware crashed.
bool chip_run(avr_cycle_count_t cycles);
