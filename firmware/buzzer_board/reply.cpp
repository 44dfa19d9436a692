#include "reply.h"

#include "protocol.h"
#include "serial_line.h"

void Reply::put(uint8_t byte) {
    crc_ = crc8(crc_, byte);
    serial_line::put(byte);
}

Reply &Reply::text(const char *in_flash) {
    while (const uint8_t byte = pgm_read_byte(in_flash++)) put(byte);
    return *this;
}

Reply &Reply::number(uint32_t value) {
    char digits[10];
    uint8_t n_digits = 0;
    do {
        digits[n_digits++] = (char)('0' + value % 10);
        value /= 10;
    } while (value);
    while (n_digits) put((uint8_t)digits[--n_digits]);
    return *this;
}

Reply &Reply::value(const char *key, uint32_t value) { return text(PSTR(" ")).text(key).text(PSTR("=")).number(value); }

Reply &Reply::name(const char *key, const char *name) { return text(PSTR(" ")).text(key).text(PSTR("=")).text(name); }

static uint8_t hex_digit(uint8_t nibble) { return (uint8_t)(nibble < 10 ? '0' + nibble : 'A' + nibble - 10); }

void Reply::end() {
    serial_line::put('*');
    serial_line::put(hex_digit(crc_ >> 4));
    serial_line::put(hex_digit(crc_ & 15));
    serial_line::put('\n');
}
