// The trace: every change of an output pin, with the CPU cycle it happened at.
#pragma once

#include <time.h>

#include "sim_avr.h"

void trace_open(const char *path, avr_t *avr);
// To be called when the chip resets: all pins fall. The count of cycles goes on.
void trace_reset(const char *cause);
// To be called when the pace begins: cycle 0 is due at this time of the monotonic clock.
void trace_pace(const struct timespec *start);
void trace_flush(void);
