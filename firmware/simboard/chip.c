#include "chip.h"

#include <elf.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "avr_extint.h"
#include "hex.h"
#include "sim_elf.h"
#include "sim_regbit.h"
#include "trace.h"

enum { FREQUENCY_HZ = 16000000, MOST_CYCLES = 3200 };  // at a time, between two looks at the serial line
enum { TIFR1 = 0x36, TIMSK1 = 0x6f, TOV1 = 1 };
enum { WDTCSR = 0x60, WDP0_TO_2 = 7, WDP3 = 1 << 5 };   // ATmega328P and 2560

enum { FAMILY_MASK = 0x7f, FAMILY_OF_MEGA = 6 };        // in the header of an ELF file

static avr_t *chip;
static bool was_reset;
static const char *cause = "watchdog";  // what resets the chip unasked
static void (*core_reset)(avr_t *);
static avr_int_vector_t *watchdog, *lap;
static avr_cycle_count_t unserved_since, lap_gone_at;

static void fail(const char *what, const char *which) {
    fprintf(stderr, "simboard: %s: %s\n", which, what);
    exit(2);
}

static void load(const uint8_t *bytes, uint32_t size, uint32_t base, const char *path) {
    if (base > chip->flashend || size > chip->flashend + 1 - base) fail("does not fit into the flash", path);
    memcpy(chip->flash + base, bytes, size);
}

static void refuse_other_chip(const char *path) {
    Elf32_Ehdr header = {0};
    FILE *file = fopen(path, "rb");
    const bool is_elf = file && fread(&header, sizeof header, 1, file) == 1 && !memcmp(header.e_ident, ELFMAG, SELFMAG);
    if (file) fclose(file);
    if (!is_elf) fail("not an AVR ELF file", path);
    const bool is_for_mega = (header.e_flags & FAMILY_MASK) == FAMILY_OF_MEGA, is_mega = chip->flashend >= 1 << 17;
    if (is_for_mega && !is_mega) fail("this image is not for an ATmega328P: give --mcu atmega2560", path);
    if (!is_for_mega && is_mega) fail("this image is not for an ATmega2560: leave out --mcu", path);
}

static void load_elf(const char *path) {
    refuse_other_chip(path);
    elf_firmware_t elf = {0};
    if (elf_read_firmware(path, &elf) != 0 || !elf.flash) fail("not an AVR ELF file", path);
    load(elf.flash, elf.flashsize, elf.flashbase, path);
}

static void load_hex(const char *path) {
    struct hex_image image;
    if (!hex_read(path, &image)) fail("not an Intel hex file", path);
    for (uint32_t address = image.lowest; address <= image.highest; address++)
        if (image.is_set[address]) load(&image.bytes[address], 1, address, path);
    if (image.lowest > 0) chip->reset_pc = image.lowest;
    hex_free(&image);
}

// A low interrupt pin would be looked at in every cycle, and buzzers 1 and 2 are on such pins. Resets ask for it anew.
static void spare_level_triggers(void) {
    for (uint8_t number = 0; number < EXTINT_COUNT; number++) avr_extint_set_strict_lvl_trig(chip, number, 0);
    was_reset = false;
}

static void resetting(avr_t *avr) {
    trace_reset(cause);
    cause = "watchdog";
    was_reset = true;
    if (core_reset) core_reset(avr);
}

static void never_sleep(avr_t *avr, avr_cycle_count_t cycles) {
    (void)avr;  // the main loop keeps the pace
    (void)cycles;
}

// Once for each kind of error: firmware that runs wild makes the same one over and over.
static void log_errors(avr_t *avr, const int level, const char *format, va_list arguments) {
    (void)avr;
    static const char *last_format;
    if (level > LOG_ERROR || format == last_format) return;
    last_format = format;
    vfprintf(stderr, format, arguments);
}

static void find_vectors(void) {
    for (unsigned i = 0; i < chip->interrupts.vector_count; i++) {
        avr_int_vector_t *vector = chip->interrupts.vector[i];
        if (vector->enable.reg == WDTCSR) watchdog = vector;
        if (vector->enable.reg == TIMSK1 && 1 << vector->enable.bit == TOV1) lap = vector;
    }
}

static void note_lap_gone(struct avr_irq_t *irq, uint32_t is_pending, void *parameter) {
    (void)irq, (void)parameter;
    if (!is_pending) lap_gone_at = chip->cycle;
}

// Clearing other flags of Timer 1 leaves its overflow alone. libsimavr forgets an overflow that waits just then.
static void keep_lap(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter) {
    (void)address, (void)parameter;
    if (lap_gone_at == avr->cycle && !(value & TOV1)) avr_raise_interrupt(avr, lap);
}

static void guard_laps(void) {
    avr_irq_register_notify(lap->irq + AVR_INT_IRQ_PENDING, note_lap_gone, NULL);
    avr_register_io_write(chip, TIFR1, keep_lap, NULL);
}

avr_t *chip_make(const char *mcu, char *const images[], int n_images) {
    avr_global_logger_set(log_errors);
    chip = avr_make_mcu_by_name(mcu);
    if (!chip) fail("libsimavr does not know this chip", mcu);
    avr_init(chip);
    chip->frequency = FREQUENCY_HZ;
    chip->sleep = never_sleep;
    chip->run_cycle_limit = MOST_CYCLES;
    chip->codeend = chip->flashend;
    for (int i = 0; i < n_images; i++) {
        if (access(images[i], R_OK)) fail(strerror(errno), images[i]);
        const char *suffix = strrchr(images[i], '.');
        (suffix && !strcmp(suffix, ".hex") ? load_hex : load_elf)(images[i]);
    }
    core_reset = chip->reset;
    chip->reset = resetting;
    find_vectors();
    guard_laps();
    return chip;
}

static void reset(const char *why, avr_regbit_t flag) {
    cause = why;
    avr_reset(chip);
    avr_regbit_set(chip, flag);
}

void chip_power_on(void) {
    reset("power", chip->reset_flags.porf);
    // A boot loader waits for a new sketch only after an external reset; plugging a board in does one too.
    if (chip->reset_pc) avr_regbit_set(chip, chip->reset_flags.extrf);
}

void chip_external_reset(void) { reset("external", chip->reset_flags.extrf); }

// The watchdog resets a chip that did not serve its interrupt before the next time-out. libsimavr forgets that.
static void reset_deaf_chip(void) {
    if (!watchdog->pending) {
        unserved_since = chip->cycle;
        return;
    }
    const uint8_t control = chip->data[WDTCSR];
    const unsigned prescaler = (control & WDP0_TO_2) | (control & WDP3 ? 8 : 0);
    const avr_cycle_count_t time_out = (avr_cycle_count_t)(2048u << prescaler) * (FREQUENCY_HZ / 128000);
    if (chip->cycle - unserved_since >= time_out) reset("watchdog", chip->reset_flags.wdrf);
}

bool chip_run(avr_cycle_count_t cycles) {
    for (avr_cycle_count_t end = chip->cycle + cycles; chip->cycle < end;) {
        int state = avr_run(chip);
        if (was_reset) spare_level_triggers();
        if (state == cpu_Done || state == cpu_Crashed) return false;
    }
    reset_deaf_chip();
    return true;
}
