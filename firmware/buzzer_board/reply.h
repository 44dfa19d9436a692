// What the board says: lines of words and `key=value` pairs, ended by their checksum.
#pragma once

#include <avr/pgmspace.h>
#include <stdint.h>

class Reply {
  public:
    Reply &text(const char *in_flash);  // all texts are in flash: use PSTR
    Reply &number(uint32_t value);
    Reply &value(const char *key, uint32_t value);
    Reply &name(const char *key, const char *name);
    // Ends the line with its checksum; nothing may follow.
    void end();

  private:
    void put(uint8_t byte);
    uint8_t crc_ = 0;
};
