#include "protocol.h"

#include <string.h>

#include "config.h"

uint8_t crc8(uint8_t crc, uint8_t byte) {
    crc ^= byte;
    for (uint8_t bit = 0; bit < 8; bit++) crc = (uint8_t)((crc << 1) ^ (crc & 0x80 ? 0x07 : 0));
    return crc;
}

namespace {

// The words of a line, one after the other.
struct Words {
    char *rest;

    // The next word, ended by a NUL in place; NULL when there is none.
    char *next() {
        while (*rest == ' ') rest++;
        if (!*rest) return nullptr;
        char *word = rest;
        while (*rest && *rest != ' ') rest++;
        if (*rest) *rest++ = '\0';
        return word;
    }

    bool at_end() {
        while (*rest == ' ') rest++;
        return !*rest;
    }
};

// A decimal number of 1 to 10 digits; values beyond 32 bits become the largest one, which no range allows.
bool number(const char *word, uint32_t &value) {
    if (!word || !*word) return false;
    uint64_t sum = 0;
    uint8_t digits = 0;
    for (; *word; word++) {
        if (*word < '0' || *word > '9' || ++digits > 10) return false;
        sum = sum * 10 + (uint8_t)(*word - '0');
    }
    value = sum > UINT32_MAX ? UINT32_MAX : (uint32_t)sum;
    return true;
}

int8_t hex_digit(char digit) {
    if (digit >= '0' && digit <= '9') return (int8_t)(digit - '0');
    digit |= 0x20;
    return digit >= 'a' && digit <= 'f' ? (int8_t)(digit - 'a' + 10) : -1;
}

// Checks the checksum where there is one, and cuts it off.
bool checksum_fits(char *line) {
    char *star = strchr(line, '*');
    if (!star) return true;
    if (strlen(star) != 3 || hex_digit(star[1]) < 0 || hex_digit(star[2]) < 0) return false;
    uint8_t crc = 0;
    for (const char *byte = line; byte < star; byte++) crc = crc8(crc, (uint8_t)*byte);
    *star = '\0';
    return crc == (uint8_t)(hex_digit(star[1]) << 4 | hex_digit(star[2]));
}

Verb verb_of(const char *word) {
    static const struct {
        char name[7];
        Verb verb;
    } VERBS[] = {{"hello", VERB_HELLO}, {"play", VERB_PLAY},     {"stop", VERB_STOP},
                 {"ping", VERB_PING},   {"status", VERB_STATUS}, {"test", VERB_TEST}};
    for (const auto &known : VERBS)
        if (word && !strcmp(word, known.name)) return known.verb;
    return VERB_NONE;
}

bool within(uint32_t value, uint32_t low, uint32_t high) { return value >= low && value <= high; }

Error parse_mls(Words &words, Wave &wave) {
    uint32_t order;
    if (!number(words.next(), order) || !number(words.next(), wave.start_hz) || !words.at_end()) return ERROR_ARGUMENT;
    if (!within(order, MIN_ORDER, MAX_ORDER) || !within(wave.start_hz, MIN_CHIP_HZ, MAX_CHIP_HZ)) return ERROR_RANGE;
    wave.kind = WAVE_MLS;
    wave.order = (uint8_t)order;
    wave.stop_hz = wave.start_hz;
    const uint32_t n_chips = (1ul << order) - 1;
    wave.duration_us = (uint32_t)((n_chips * 1000000ull + wave.start_hz / 2) / wave.start_hz);
    return within(wave.duration_us, MIN_DURATION_US, MAX_DURATION_US) ? ERROR_NONE : ERROR_RANGE;
}

Error parse_cycles(Words &words, Wave &wave, bool sweeps) {
    wave.kind = sweeps ? WAVE_SWEEP : WAVE_TONE;
    if (!number(words.next(), wave.start_hz)) return ERROR_ARGUMENT;
    wave.stop_hz = wave.start_hz;
    if (sweeps && !number(words.next(), wave.stop_hz)) return ERROR_ARGUMENT;
    if (!number(words.next(), wave.duration_us) || !words.at_end()) return ERROR_ARGUMENT;
    const bool possible = within(wave.start_hz, MIN_HZ, MAX_HZ) && within(wave.stop_hz, MIN_HZ, MAX_HZ) &&
                          within(wave.duration_us, MIN_DURATION_US, MAX_DURATION_US);
    return possible ? ERROR_NONE : ERROR_RANGE;
}

Error parse_wave(Words &words, Wave &wave) {
    const char *kind = words.next();
    if (!kind) return ERROR_ARGUMENT;
    if (!strcmp(kind, "mls")) return parse_mls(words, wave);
    if (!strcmp(kind, "sweep")) return parse_cycles(words, wave, true);
    if (!strcmp(kind, "tone")) return parse_cycles(words, wave, false);
    return ERROR_ARGUMENT;
}

Error parse_play(Words &words, Command &command) {
    uint32_t buzzer;
    if (!number(words.next(), buzzer)) return ERROR_ARGUMENT;
    const Error error = parse_wave(words, command.wave);
    if (error == ERROR_ARGUMENT) return error;
    if (!within(buzzer, 1, N_BUZZERS)) return ERROR_BUZZER;
    command.buzzer = (uint8_t)buzzer;
    return error;
}

Error parse(char *line, Command &command) {
    if (!checksum_fits(line)) return ERROR_CHECKSUM;
    Words words = {line};
    uint32_t seq;
    if (!number(words.next(), seq) || seq > UINT16_MAX) return ERROR_VERB;
    command.seq = (uint16_t)seq;
    command.verb = verb_of(words.next());
    if (command.verb == VERB_NONE) return ERROR_VERB;
    if (command.verb == VERB_PLAY) return parse_play(words, command);
    return words.at_end() ? ERROR_NONE : ERROR_ARGUMENT;
}

bool is_blank(const char *line) { return Words{const_cast<char *>(line)}.at_end(); }

}  // namespace

bool LineReader::take(uint8_t byte, Command &command) {
    if (byte != '\n' && byte != '\r') {
        if (byte < 0x20 || byte > 0x7e || length_ == MAX_LENGTH) invalid_ = true;
        if (!invalid_) line_[length_++] = (char)byte;
        return false;
    }
    line_[length_] = '\0';
    const bool is_line = invalid_ || !is_blank(line_);
    command = Command();
    if (is_line) command.error = invalid_ ? ERROR_LINE : parse(line_, command);
    length_ = 0;
    invalid_ = false;
    return is_line;
}
