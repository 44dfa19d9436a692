// The buzzer board of an acoustic camera. Pins and limits are in config.h; what it says and hears is in ../PROTOCOL.md.
#include "board_clock.h"
#include "commands.h"
#include "health.h"
#include "player.h"
#include "serial_line.h"

void setup() {
    player::begin();  // pins first: silence
    health::begin();
    board_clock::begin();
    serial_line::begin();
    commands::begin();
}

void loop() {
    health::alive();
    commands::turn();
}
