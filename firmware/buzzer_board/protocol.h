// The line protocol: bytes to commands. Pure, so that it also runs on a host; see ../PROTOCOL.md.
#pragma once

#include <stdint.h>

#include "wave.h"

enum Error : uint8_t {
    ERROR_NONE = 0,
    ERROR_CHECKSUM = 1,
    ERROR_LINE = 2,
    ERROR_VERB = 3,
    ERROR_ARGUMENT = 4,
    ERROR_RANGE = 5,
    ERROR_BUSY = 6,
    ERROR_BUZZER = 7,
    ERROR_FAULT = 8,
    ERROR_TEST = 9,
};

enum Verb : uint8_t { VERB_NONE, VERB_HELLO, VERB_PLAY, VERB_STOP, VERB_PING, VERB_STATUS, VERB_TEST };

// One line of the host: a command, or what is wrong with it.
struct Command {
    uint16_t seq;  // 0 where it could not be read
    Verb verb;
    Error error;
    uint8_t buzzer;  // counted from 1
    Wave wave;
};

uint8_t crc8(uint8_t crc, uint8_t byte);

// Collects bytes until they are a line.
class LineReader {
  public:
    // Takes the next byte; true when `command` holds what the line says. Empty lines are no lines, so CR LF ends one.
    bool take(uint8_t byte, Command &command);

  private:
    static constexpr uint8_t MAX_LENGTH = 80;
    char line_[MAX_LENGTH + 1];
    uint8_t length_ = 0;
    bool invalid_ = false;
};
