// The commands: what the host asks, the board does and answers.
#pragma once

namespace commands {

void begin();  // says that the board has started
// One turn of the main loop: tells what happened, takes up to one line that came in, rests until the next interrupt.
void turn();

}  // namespace commands
