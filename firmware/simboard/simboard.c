// The simulated board: runs real firmware at the pace of real time, its serial line a pseudo-terminal.
#define _GNU_SOURCE
#include <getopt.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "chip.h"
#include "line.h"
#include "trace.h"

static const char USAGE[] =
    "usage: simboard [options] IMAGE [IMAGE ...]\n"
    "Runs firmware (.elf, .hex, a boot loader's .hex too) on a simulated board; prints the path of its serial port.\n"
    "  --mcu NAME    atmega328p (default: an Uno or Nano) or atmega2560 (a Mega)\n"
    "  --link PATH   make PATH a symbolic link to the serial port; nothing that is there is replaced\n"
    "  --dtr         reset the board when a host opens the port, as a real one does\n"
    "  --trace FILE  write every change of an output pin: cycle, pin, level; and when cycle 0 was\n"
    "  --pace FILE   write when it ran: cycle, nanoseconds of CLOCK_MONOTONIC\n"
    "  --fast        run as fast as possible instead of at the pace of real time\n"
    "Signals: SIGUSR1 resets the board, SIGTERM and SIGINT end it.\n";

enum { STEP_CYCLES = 3200, FLUSH_STEPS = 25 };  // 0.2 ms, 5 ms

struct options {
    const char *mcu, *link, *trace, *pace;
    int dtr, fast;
};

static volatile sig_atomic_t ending, resetting;

static void on_signal(int number) {
    if (number == SIGUSR1)
        resetting = 1;
    else
        ending = 1;
}

static void catch_signals(void) {
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGUSR1, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
}

static struct options parse(int n_arguments, char **arguments) {
    struct options options = {.mcu = "atmega328p"};
    const struct option known[] = {
        {"mcu", required_argument, NULL, 'm'},      {"link", required_argument, NULL, 'l'},
        {"trace", required_argument, NULL, 't'},    {"dtr", no_argument, &options.dtr, 1},
        {"pace", required_argument, NULL, 'p'},     {"fast", no_argument, &options.fast, 1},
        {"help", no_argument, NULL, 'h'},           {NULL, 0, NULL, 0},
    };
    for (int letter; (letter = getopt_long(n_arguments, arguments, "h", known, NULL)) != -1;) switch (letter) {
            case 'm': options.mcu = optarg; break;
            case 'l': options.link = optarg; break;
            case 't': options.trace = optarg; break;
            case 'p': options.pace = optarg; break;
            case 'h': fputs(USAGE, stdout); exit(0);
            case '?': fputs(USAGE, stderr); exit(2);
        }
    if (optind == n_arguments) {
        fputs(USAGE, stderr);
        exit(2);
    }
    return options;
}

// Sleeps until real time has caught up; a board that fell behind catches up itself, so its clock does not drift.
static void keep_pace(uint64_t cycle, uint32_t frequency_hz) {
    static struct timespec start;
    if (!start.tv_sec && !start.tv_nsec) {
        clock_gettime(CLOCK_MONOTONIC, &start);
        trace_pace(&start);
    }
    uint64_t nanoseconds = cycle / frequency_hz * 1000000000u + cycle % frequency_hz * 1000000000u / frequency_hz;
    struct timespec due = {start.tv_sec + (time_t)(nanoseconds / 1000000000u),
                           start.tv_nsec + (long)(nanoseconds % 1000000000u)};
    if (due.tv_nsec >= 1000000000) due.tv_sec++, due.tv_nsec -= 1000000000;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
}

static FILE *pace;

static void open_pace(const char *path) {
    if (path && !(pace = fopen(path, "w"))) {
        perror(path);
        exit(2);
    }
    if (pace) fputs("# cycle nanoseconds\n", pace);
}

// Writes when this cycle runs: a busy computer lets the board stand still now and then, as no real one does.
static void tell_pace(uint64_t cycle) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    if (pace) fprintf(pace, "%" PRIu64 " %" PRIu64 "\n", cycle, (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec);
}

static void flush_logs(void) {
    trace_flush();
    if (pace) fflush(pace);
}

static void reset_board(void) {
    resetting = 0;
    line_reset();
    chip_external_reset();
}

// Returns false when the firmware did what no firmware may.
static bool run(avr_t *chip, const struct options *options) {
    const double step_s = (double)STEP_CYCLES / chip->frequency;
    for (unsigned step = 0; !ending; step++) {
        tell_pace(chip->cycle);
        if (!chip_run(STEP_CYCLES)) return false;
        if (line_carry(step_s) && options->dtr) resetting = 1;
        if (resetting) reset_board();
        if (step % FLUSH_STEPS == 0) flush_logs();
        if (!options->fast) keep_pace(chip->cycle, chip->frequency);
    }
    return true;
}

int main(int n_arguments, char **arguments) {
    catch_signals();
    struct options options = parse(n_arguments, arguments);
    avr_t *chip = chip_make(options.mcu, arguments + optind, n_arguments - optind);
    trace_open(options.trace, chip);
    open_pace(options.pace);
    puts(line_open(chip, options.link));
    fflush(stdout);
    chip_power_on();
    const bool is_well = run(chip, &options);
    flush_logs();
    line_close();
    if (!is_well)
        fprintf(stderr, "simboard: the firmware crashed at address 0x%04x; if it is not for an %s, give --mcu\n",
                (unsigned)chip->pc, options.mcu);
    return is_well ? 0 : 1;
}
