// The commands: what the host asks, the board does and answers.
#pragma once

namespace commands {

void begin();  // says that the board has started
// One turn of the main loop: tells what happened, then takes what came in, up to one line; then rests until the next interrupt.
void turn();

}  // namespace commands
