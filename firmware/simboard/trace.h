// The trace: every change of an output pin, with the CPU cycle it happened at.
#pragma once

#include "sim_avr.h"

void trace_open(const char *path, avr_t *avr);
// To be called when the chip resets: all pins fall. The count of cycles goes on.
void trace_reset(const char *cause);
void trace_flush(void);
