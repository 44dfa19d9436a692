#include "commands.h"

#include <avr/interrupt.h>
#include <avr/sleep.h>

#include "board_clock.h"
#include "config.h"
#include "health.h"
#include "player.h"
#include "protocol.h"
#include "reply.h"
#include "serial_line.h"

namespace {

constexpr uint16_t LEAST_MEMORY = 64;
constexpr uint8_t ROOM_FOR_A_TURN = 245;  // bytes: the events of one emission, a fault, and the longest reply

LineReader reader;
uint16_t n_errors;
uint8_t fault, suspected_fault;
bool fault_is_told = true;

const char IDENTITY[] PROGMEM =
    " name=" FIRMWARE_NAME " fw=" FIRMWARE_VERSION " proto=" PROTOCOL_VERSION " board=" BOARD_NAME;
const char ERROR_NAMES[] PROGMEM = "none\0checksum\0line\0verb\0argument\0range\0busy\0buzzer\0fault\0test";
const char FAULT_NAMES[] PROGMEM = "none\0pin\0timer\0memory";
const char RESET_NAMES[] PROGMEM = "power\0external\0brownout\0watchdog";
const char WHY_NAMES[] PROGMEM = "done\0stop\0limit\0fault";

// Of a list of names that end with NUL, the one with this index.
const char *named(const char *names, uint8_t index) {
    while (index)
        if (!pgm_read_byte(names++)) index--;
    return names;
}

void refuse(const Command &command, Error error) {
    n_errors++;
    Reply().number(command.seq).text(PSTR(" err ")).number(error).text(PSTR(" ")).text(named(ERROR_NAMES, error)).end();
}

Reply accept(const Command &command) {
    Reply reply;
    reply.number(command.seq).text(PSTR(" ok"));
    return reply;
}

void hello(const Command &command) {
    accept(command)
        .text(IDENTITY)
        .value(PSTR("buzzers"), N_BUZZERS)
        .value(PSTR("max_us"), MAX_DURATION_US)
        .value(PSTR("min_hz"), MIN_HZ)
        .value(PSTR("max_hz"), MAX_HZ)
        .end();
}

void tell_events() {
    Emission emission;
    if (player::began(emission))
        Reply()
            .text(PSTR("! on"))
            .value(PSTR("buzzer"), emission.buzzer)
            .value(PSTR("us"), emission.on_us)
            .value(PSTR("seq"), emission.seq)
            .end();
    if (player::ended(emission))
        Reply()
            .text(PSTR("! off"))
            .value(PSTR("buzzer"), emission.buzzer)
            .value(PSTR("us"), emission.off_us)
            .value(PSTR("seq"), emission.seq)
            .name(PSTR("why"), named(WHY_NAMES, emission.why))
            .end();
    if (fault_is_told) return;
    fault_is_told = true;
    Reply().text(PSTR("! fault")).value(PSTR("code"), fault).name(PSTR("name"), named(FAULT_NAMES, fault)).end();
}

void play(const Command &command) {
    if (fault) return refuse(command, ERROR_FAULT);
    if (player::buzzer()) return refuse(command, ERROR_BUSY);
    tell_events();  // of the emission before, which may just have ended
    const uint32_t on_us = player::play(command.buzzer, command.wave, command.seq);
    accept(command).value(PSTR("on_us"), on_us).end();
}

void stop(const Command &command) {
    const uint8_t was = player::buzzer();
    player::stop(WHY_STOP);
    accept(command).value(PSTR("was"), was).end();
}

void status(const Command &command) {
    const uint8_t buzzer = player::buzzer();
    accept(command)
        .name(PSTR("state"), fault ? PSTR("fault") : buzzer ? PSTR("playing") : PSTR("idle"))
        .value(PSTR("buzzer"), buzzer)
        .value(PSTR("us"), board_clock::now().us())
        .value(PSTR("plays"), player::plays())
        .value(PSTR("errors"), n_errors)
        .value(PSTR("fault"), fault)
        .name(PSTR("reset"), named(RESET_NAMES, health::last_reset()))
        .end();
}

void test(const Command &command) {
    const uint16_t unused = health::unused_memory(UINT16_MAX);
    if (fault || unused < LEAST_MEMORY || !board_clock::runs()) return refuse(command, ERROR_TEST);
    accept(command).value(PSTR("pass"), 1).value(PSTR("ram"), unused).name(PSTR("clock"), PSTR("ok")).end();
}

void answer(const Command &command) {
    if (command.error) return refuse(command, command.error);
    switch (command.verb) {
        case VERB_HELLO: return hello(command);
        case VERB_PLAY: return play(command);
        case VERB_STOP: return stop(command);
        case VERB_PING: return accept(command).value(PSTR("us"), serial_line::newline_us()).end();
        case VERB_STATUS: return status(command);
        case VERB_TEST: return test(command);
        case VERB_NONE: return refuse(command, ERROR_VERB);
    }
}

// Believed only when seen twice in a row: a pin may still be on its way down.
void look_for_faults() {
    const uint8_t found =
        health::unused_memory(LEAST_MEMORY) < LEAST_MEMORY ? (uint8_t)FAULT_MEMORY : player::impossible();
    if (found && found == suspected_fault && !fault) {
        player::stop(WHY_FAULT);
        fault = found;
        fault_is_told = false;
    }
    suspected_fault = found;
}

// Sleeps until the next interrupt, unless there is something to do. It also keeps the edges' latency the same.
void rest() {
    set_sleep_mode(SLEEP_MODE_IDLE);
    cli();
    if (serial_line::is_quiet() && !player::needs_watching() && !suspected_fault) {
        sleep_enable();
        sei();  // takes effect after the next instruction, so nothing slips in between
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

void take_a_line() {
    Command command;
    for (uint8_t byte; serial_line::get(byte);)
        if (reader.take(byte, command)) return answer(command);
}

}  // namespace

void commands::begin() {
    Reply()
        .text(PSTR("! boot"))
        .text(IDENTITY)
        .name(PSTR("reset"), named(RESET_NAMES, health::last_reset()))
        .end();
}

void commands::turn() {
    look_for_faults();
    serial_line::send();
    if (serial_line::room() >= ROOM_FOR_A_TURN) {
        tell_events();
        take_a_line();
    }
    rest();
}
