#include "serial_line.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board_clock.h"

#ifndef USART_RX_vect  // chips with more than one UART
#define USART_RX_vect USART0_RX_vect
#endif

namespace {

constexpr uint8_t IN_SIZE = 128;    // a power of two
volatile uint8_t in[IN_SIZE];
volatile uint8_t in_head, in_tail;
uint8_t out[256];                   // indices wrap by themselves
uint8_t out_head, out_tail;
board_clock::Stamp last_newline;

}  // namespace

ISR(USART_RX_vect) {
    const bool broken = UCSR0A & (_BV(FE0) | _BV(DOR0));
    uint8_t byte = UDR0;
    if (broken) byte = 0;  // makes the line invalid
    const uint8_t next = (uint8_t)(in_head + 1) % IN_SIZE;
    if (next == in_tail) {
        in[(uint8_t)(in_head - 1) % IN_SIZE] = 0;  // full: the line that lost a byte must not be taken for a command
        return;
    }
    const uint8_t before = in[(uint8_t)(in_head - 1) % IN_SIZE];
    if (byte == '\r' || (byte == '\n' && before != '\r')) last_newline = board_clock::stamp();
    in[in_head] = byte;
    in_head = next;
}

void serial_line::begin() {
    UCSR0A |= _BV(U2X0);
    UBRR0H = 0;
    UBRR0L = (uint8_t)((F_CPU / 4 / 115200 - 1) / 2);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool serial_line::get(uint8_t &byte) {
    if (in_tail == in_head) return false;
    byte = in[in_tail];
    in_tail = (uint8_t)(in_tail + 1) % IN_SIZE;
    return true;
}

bool serial_line::is_quiet() { return in_tail == in_head && out_tail == out_head; }

uint32_t serial_line::newline_us() {
    board_clock::Stamp newline;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { newline = last_newline; }
    return newline.us();
}

uint8_t serial_line::room() { return (uint8_t)(out_tail - out_head - 1); }

void serial_line::put(uint8_t byte) {
    if (room()) out[out_head++] = byte;
}

void serial_line::send() {
    if (out_tail != out_head && (UCSR0A & _BV(UDRE0))) UDR0 = out[out_tail++];
}
