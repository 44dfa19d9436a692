#include "trace.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "avr_ioport.h"

enum { PORTS = 12, PINS = 8 };  // ports A to L

static FILE *file;
static avr_t *chip;
static uint8_t levels[PORTS];

static void put(unsigned port, unsigned pin, unsigned level) {
    if (((levels[port] >> pin) & 1u) == level) return;
    levels[port] ^= (uint8_t)(1u << pin);
    if (file) fprintf(file, "%" PRIu64 " P%c%u %u\n", chip->cycle, 'A' + port, pin, level);
}

static void pin_changed(struct avr_irq_t *irq, uint32_t value, void *port) {
    put((unsigned)(uintptr_t)port, irq->irq, value & 1u);
}

static void listen(void) {
    for (unsigned port = 0; port < PORTS; port++)
        for (unsigned pin = 0; pin < PINS; pin++) {
            avr_irq_t *irq = avr_io_getirq(chip, AVR_IOCTL_IOPORT_GETIRQ('A' + port), (int)pin);
            if (irq) avr_irq_register_notify(irq, pin_changed, (void *)(uintptr_t)port);
        }
}

void trace_open(const char *path, avr_t *avr) {
    chip = avr;
    if (path && !(file = fopen(path, "w"))) {
        perror(path);
        exit(2);
    }
    if (file) fprintf(file, "# cycle pin level; %" PRIu32 " cycles a second\n", avr->frequency);
    listen();
}

void trace_reset(const char *cause) {
    for (unsigned port = 0; port < PORTS; port++)
        for (unsigned pin = 0; pin < PINS; pin++) put(port, pin, 0);
    if (file) fprintf(file, "%" PRIu64 " RESET %s\n", chip->cycle, cause);
}

void trace_pace(const struct timespec *start) {
    if (file) fprintf(file, "# pace: cycle 0 at %lld.%09ld s of the monotonic clock\n", (long long)start->tv_sec, start->tv_nsec);
}

void trace_flush(void) {
    if (file) fflush(file);
}
