// Fuzzes the parser, guided by coverage: fuzz_parser FRAMES BYTES SEED
//
// Starts from the golden frames, mutates them, and keeps what reached code in a new way. Runs under sanitizers; checks
// on top that no line is accepted that the protocol forbids. The parser is built with -fsanitize-coverage=trace-pc.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "config.h"
#include "protocol.h"

static uint8_t reached[1 << 16];
static uintptr_t last_place;
static size_t n_reached;

extern "C" void __sanitizer_cov_trace_pc() {
    const uintptr_t place = (uintptr_t)__builtin_return_address(0);
    uint8_t &edge = reached[(place ^ last_place << 1) & 0xffff];
    n_reached += !edge;
    edge = 1;
    last_place = place;
}

namespace {

std::mt19937 generator;
size_t n_plays, n_errors[10];

size_t below(size_t limit) { return generator() % limit; }

void require(bool holds, const char *what, const std::string &line) {
    if (holds) return;
    fprintf(stderr, "accepted although %s: %s\n", what, line.c_str());
    abort();
}

void check(const Command &command, const std::string &sent) {
    require(command.error <= ERROR_TEST, "the error is unknown", sent);
    n_errors[command.error]++;
    if (command.error) return;
    require(command.verb != VERB_NONE, "it has no verb", sent);
    if (command.verb != VERB_PLAY) return;
    n_plays++;
    const Wave &wave = command.wave;
    const bool is_mls = wave.kind == WAVE_MLS;
    require(command.buzzer >= 1 && command.buzzer <= N_BUZZERS, "there is no such buzzer", sent);
    require(wave.duration_us >= MIN_DURATION_US && wave.duration_us <= MAX_DURATION_US, "of its length", sent);
    for (uint32_t hz : {wave.start_hz, wave.stop_hz})
        require(hz >= (is_mls ? MIN_CHIP_HZ : MIN_HZ) && hz <= (is_mls ? MAX_CHIP_HZ : MAX_HZ), "no such rate", sent);
    require(!is_mls || (wave.order >= MIN_ORDER && wave.order <= MAX_ORDER), "no such order", sent);
}

std::string with_checksum(std::string line) {
    line = line.substr(0, line.find('*'));
    uint8_t crc = 0;
    for (char byte : line) crc = crc8(crc, (uint8_t)byte);
    char digits[4];
    snprintf(digits, sizeof digits, "*%02X", crc);
    return line + digits;
}

std::string mutated(std::string line, const std::vector<std::string> &corpus) {
    static const char LIKELY[] = "0123456789 *\r\n";
    for (size_t times = 1 + below(4); times; times--) {
        const size_t place = below(line.size() + 1);
        const char likely = LIKELY[below(sizeof LIKELY - 1)], any = (char)below(256);
        switch (below(6)) {
            case 0: line.insert(place, 1, below(2) ? likely : any); break;
            case 1: line.erase(place, 1 + below(4)); break;
            case 2: if (place < line.size()) line[place] = below(2) ? likely : any; break;
            case 3: if (place < line.size()) line[place] ^= (char)(1 << below(8)); break;
            case 4: line.insert(place, std::string(below(90), likely)); break;
            case 5: line = line.substr(0, place) + corpus[below(corpus.size())]; break;
        }
    }
    return below(2) ? with_checksum(line) : line;
}

std::vector<std::string> golden_lines(const char *path) {
    std::vector<std::string> lines;
    std::ifstream file(path);
    for (std::string line; std::getline(file, line);)
        if (line.compare(0, 2, "> ") == 0) lines.push_back(line.substr(2));
    return lines;
}

}  // namespace

int main(int n_arguments, char **arguments) {
    if (n_arguments != 4) return fprintf(stderr, "usage: fuzz_parser FRAMES BYTES SEED\n"), 2;
    std::vector<std::string> corpus = golden_lines(arguments[1]);
    if (corpus.empty()) return fprintf(stderr, "%s: no golden frames\n", arguments[1]), 2;
    const size_t n_bytes = strtoull(arguments[2], nullptr, 10);
    generator.seed((unsigned)strtoul(arguments[3], nullptr, 10));
    LineReader reader;
    size_t n_fed = 0, n_lines = 0;
    while (n_fed < n_bytes) {
        const bool is_golden = n_lines < corpus.size() && n_fed < n_bytes / 2 && n_lines < 1000;
        const std::string line = is_golden ? corpus[n_lines] : mutated(corpus[below(corpus.size())], corpus);
        const size_t reached_before = n_reached;
        Command command;
        for (char byte : line + "\n") {
            n_fed++;
            if (reader.take((uint8_t)byte, command)) check(command, line);
        }
        n_lines++;
        if (n_reached > reached_before && line.size() < 200) corpus.push_back(line);
    }
    printf("%zu bytes, %zu lines, %zu plays, ", n_fed, n_lines, n_plays);
    printf("%zu kept, %zu places; errors", corpus.size(), n_reached);
    for (size_t number = 0; number < 10; number++) printf(" %zu", n_errors[number]);
    puts("");
}
