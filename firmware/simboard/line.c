#define _GNU_SOURCE
#include "line.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/stat.h>
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
static char port_path[64];
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

// Whether the link leads to this path; false where it is no symbolic link, too.
static bool link_leads_to(const char *link, const char *path) {
    char target[PATH_MAX];
    const ssize_t length = readlink(link, target, sizeof target - 1);
    if (length < 0) return false;
    target[length] = '\0';
    return !strcmp(target, path);
}

static void refuse_link(const char *link, const char *why) {
    fprintf(stderr, "simboard: %s: %s\n", link, why);
    exit(2);
}

// Takes over only what a simulated board that was killed left behind: a link that leads nowhere, or to the port that is ours now.
static void make_link(const char *link) {
    struct stat there;
    if (lstat(link, &there) == 0) {
        if (!S_ISLNK(there.st_mode)) refuse_link(link, "is there already, and is not a link to a port: give another --link");
        if (access(link, F_OK) == 0 && !link_leads_to(link, port_path))
            refuse_link(link, "leads to a port that is there: end the simulated board that made it, or give another --link");
        unlink(link);
    }
    if (symlink(port_path, link)) refuse_link(link, strerror(errno));
    link_path = link;
}

const char *line_open(avr_t *avr, const char *link) {
    connect_uart(avr);
    master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (master < 0 || grantpt(master) || unlockpt(master)) fail("pseudo-terminal");
    if (ptsname_r(master, port_path, sizeof port_path)) fail("pseudo-terminal");
    int slave = open(port_path, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (slave < 0 || tcgetattr(slave, &raw)) fail(port_path);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    close(slave);
    watch = inotify_init1(IN_NONBLOCK);
    if (watch < 0 || inotify_add_watch(watch, port_path, IN_OPEN | IN_CLOSE) < 0) fail(port_path);
    if (link) make_link(link);
    return port_path;
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
    if (link_path && link_leads_to(link_path, port_path)) unlink(link_path);
}
