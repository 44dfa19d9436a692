// The board's health: why it started, what went wrong since, and the watchdog that ends what hangs.
#pragma once

#include <stdint.h>

enum Fault : uint8_t { FAULT_NONE = 0, FAULT_PIN = 1, FAULT_TIMER = 2, FAULT_MEMORY = 3 };
enum Reset : uint8_t { RESET_POWER, RESET_EXTERNAL, RESET_BROWNOUT, RESET_WATCHDOG };

namespace health {

void begin();
// To be called in every turn of the main loop: all is well.
void alive();
Reset last_reset();
// Bytes of memory that the stack never reached; looks at no more than `most`.
uint16_t unused_memory(uint16_t most);

}  // namespace health
