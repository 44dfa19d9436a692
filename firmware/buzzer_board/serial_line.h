// The serial line: UART 0 at 115200 baud. Nothing here ever waits.
#pragma once

#include <stdint.h>

namespace serial_line {

void begin();
// Takes the oldest byte that came in; false when there is none.
bool get(uint8_t &byte);
// Whether nothing waits to be taken or sent.
bool is_quiet();
// The board's clock when the last end of a line came in: LF, CR, or the CR of both.
uint32_t newline_us();
// How many bytes `put` takes now.
uint8_t room();
void put(uint8_t byte);
// Hands the next byte to the UART if it is free. Polled, not interrupt-driven: an interrupt would shift edges.
void send();

}  // namespace serial_line
