#define _GNU_SOURCE
#include "line.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <termios.h>
#include <unistd.h>

#include "avr_uart.h"
#include "sim_io.h"

enum { UCSR0A = 0xc0, UCSR0B = 0xc1, UDRE0 = 1 << 5, TXEN0 = 1 << 3 };  // ATmega328P and 2560
enum { SLOW_BYTE_CYCLES = 3200 };  // at 57600 baud, and a little more
static const double BYTES_A_SECOND = 115200.0 / 10;

static int master, watch;
static unsigned n_hosts;
static avr_irq_t *to_chip;
static const char *link_path;
static bool chip_is_full;
static double budget_bytes;
static avr_cycle_count_t last_sent_cycle;
static unsigned char outgoing[4096];
static size_t n_outgoing;

static void sent_by_chip(struct avr_irq_t *irq, uint32_t value, void *chip) {
    (void)irq;
    last_sent_cycle = ((avr_t *)chip)->cycle;
    if (n_outgoing < sizeof outgoing) outgoing[n_outgoing++] = (unsigned char)value;
}

static void flow_changed(struct avr_irq_t *irq, uint32_t value, void *full) {
    (void)irq;
    if (value) chip_is_full = full != NULL;
}

// libsimavr forgets that the data register of a transmitter that was just switched on is empty.
static void control_written(struct avr_t *avr, avr_io_addr_t address, uint8_t value, void *nothing) {
    (void)address, (void)nothing;
    const bool is_sending = last_sent_cycle && avr->cycle - last_sent_cycle < SLOW_BYTE_CYCLES;
    if ((value & TXEN0) && !is_sending) avr->data[UCSR0A] |= UDRE0;
}

static void connect_uart(avr_t *avr) {
    uint32_t no_flags = 0;  // no echo on stdout, no sleeping
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    to_chip = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent_by_chip, avr);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), flow_changed, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), flow_changed, &master);
    avr_register_io_write(avr, UCSR0B, control_written, NULL);
}

static void fail(const char *what) {
    perror(what);
    exit(1);
}

const char *line_open(avr_t *avr, const char *link) {
    connect_uart(avr);
    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (master < 0 || grantpt(master) || unlockpt(master)) fail("pseudo-terminal");
    const char *path = ptsname(master);
    int slave = open(path, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (slave < 0 || tcgetattr(slave, &raw)) fail(path);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    close(slave);
    watch = inotify_init1(IN_NONBLOCK);
    if (watch < 0 || inotify_add_watch(watch, path, IN_OPEN | IN_CLOSE) < 0) fail(path);
    if (link) {
        unlink(link);
        if (symlink(path, link)) fail(link);
        link_path = link;
    }
    return path;
}

static void carry_to_chip(double elapsed_s) {
    budget_bytes += elapsed_s * BYTES_A_SECOND;
    if (budget_bytes > 16) budget_bytes = 16;
    unsigned char byte;
    while (!chip_is_full && budget_bytes >= 1 && read(master, &byte, 1) == 1) {
        avr_raise_irq(to_chip, byte);
        budget_bytes--;
    }
}

static void carry_to_host(void) {
    if (!n_outgoing) return;
    ssize_t n_written = n_hosts ? write(master, outgoing, n_outgoing) : (ssize_t)n_outgoing;
    if (n_written <= 0) return;
    n_outgoing -= (size_t)n_written;
    memmove(outgoing, outgoing + n_written, n_outgoing);
}

// Counts who has the line open. Polling it would miss a host that closes and opens it at once.
static bool host_came(void) {
    char events[4096];
    ssize_t n_bytes = read(watch, events, sizeof events);
    bool came = false;
    for (char *next = events; n_bytes > 0 && next < events + n_bytes; next += sizeof(struct inotify_event)) {
        const struct inotify_event *event = (const struct inotify_event *)next;
        if (event->mask & IN_OPEN) came |= n_hosts++ == 0;
        if ((event->mask & IN_CLOSE) && n_hosts) n_hosts--;
    }
    return came;
}

bool line_carry(double elapsed_s) {
    const bool came = host_came();
    carry_to_host();
    carry_to_chip(elapsed_s);
    return came;
}

void line_reset(void) { chip_is_full = false; }

void line_close(void) {
    if (link_path) unlink(link_path);
}
