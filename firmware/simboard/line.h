// The serial line: the chip's UART 0 as a pseudo-terminal that hosts open like a board.
#pragma once

#include <stdbool.h>

#include "sim_avr.h"

// Returns the pseudo-terminal's path; `link`, where not NULL, becomes a symbolic link to it; the program ends
// where something else stands there.
const char *line_open(avr_t *avr, const char *link);
// Carries bytes both ways, at most as many to the chip as fit into the time since the last call at 115200 baud.
// Returns true when a host has just opened the line (a real board's DTR would reset it then).
bool line_carry(double elapsed_s);
// Forgets what the chip has not read yet, as a reset does.
void line_reset(void);
void line_close(void);
