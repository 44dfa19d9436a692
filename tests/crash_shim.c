// Stands between a program and the disk: logs every write to a session and its journal, or kills the program at one.
// Preloaded. RIG_SHIM_LOG names the log, none without it; shim_kill_at(n) arms the kill;
// shim_note adds a sync to the log that is only played.

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

enum operation { WRITE = 1, TRUNCATE = 2, SYNC_BEGINS = 3, SYNC_DONE = 4 };
enum file { OTHER = -1, SESSION = 0, JOURNAL = 1, MARKER = 2 };

struct entry {
    uint8_t operation, file;
    uint16_t unused;
    uint32_t length;
    int64_t offset;
} __attribute__((packed));

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int log_file = -1;
static long writes_left = -1;

static int which(int descriptor) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return OTHER;
    path[length] = 0;
    if (strstr(path, "crash.marker")) return MARKER;
    if (!strstr(path, "crash.h5")) return OTHER;
    return strstr(path, ".journal") ? JOURNAL : SESSION;
}

static void note(int operation, int file, int64_t offset, const void *bytes, uint32_t length) {
    if (log_file < 0) {
        const char *path = getenv("RIG_SHIM_LOG");
        if (!path) return;
        log_file = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND, 0600);
    }
    struct entry entry = {operation, file, 0, length, offset};
    syscall(SYS_write, log_file, &entry, sizeof entry);
    if (length) syscall(SYS_write, log_file, bytes, length);
}

void shim_note(int operation, int file) {
    pthread_mutex_lock(&lock);
    note(operation, file, 0, 0, 0);
    pthread_mutex_unlock(&lock);
}

void shim_kill_at(long writes) { writes_left = writes; }

static int kills_now(int file) {
    return (file == SESSION || file == JOURNAL) && writes_left > 0 && --writes_left == 0;
}

ssize_t pwrite64(int descriptor, const void *bytes, size_t length, off_t offset) {
    int file = which(descriptor);
    if (file == OTHER) return syscall(SYS_pwrite64, descriptor, bytes, length, offset);
    pthread_mutex_lock(&lock);
    if (kills_now(file)) {  // a kill may cut a write in two
        syscall(SYS_pwrite64, descriptor, bytes, length / 2, offset);
        raise(SIGKILL);
    }
    ssize_t written = syscall(SYS_pwrite64, descriptor, bytes, length, offset);
    if (written > 0) note(WRITE, file, offset, bytes, written);
    pthread_mutex_unlock(&lock);
    return written;
}

ssize_t pwrite(int descriptor, const void *bytes, size_t length, off_t offset) {
    return pwrite64(descriptor, bytes, length, offset);
}

ssize_t write(int descriptor, const void *bytes, size_t length) {
    int file = which(descriptor);
    if (file == OTHER) return syscall(SYS_write, descriptor, bytes, length);
    pthread_mutex_lock(&lock);
    if (kills_now(file)) {
        syscall(SYS_write, descriptor, bytes, length / 2);
        raise(SIGKILL);
    }
    int64_t offset = syscall(SYS_lseek, descriptor, 0, SEEK_CUR);
    ssize_t written = syscall(SYS_write, descriptor, bytes, length);
    if (written > 0) note(WRITE, file, offset, bytes, written);
    pthread_mutex_unlock(&lock);
    return written;
}

int ftruncate64(int descriptor, off_t length) {
    int file = which(descriptor);
    pthread_mutex_lock(&lock);
    int result = syscall(SYS_ftruncate, descriptor, length);
    if (file != OTHER) note(TRUNCATE, file, length, 0, 0);
    pthread_mutex_unlock(&lock);
    return result;
}

int ftruncate(int descriptor, off_t length) { return ftruncate64(descriptor, length); }

static int synced(int descriptor, long call) {
    int file = which(descriptor);
    if (file == OTHER) return syscall(call, descriptor);
    pthread_mutex_lock(&lock);
    note(SYNC_BEGINS, file, 0, 0, 0);
    pthread_mutex_unlock(&lock);
    int result = syscall(call, descriptor);
    pthread_mutex_lock(&lock);
    note(SYNC_DONE, file, 0, 0, 0);
    pthread_mutex_unlock(&lock);
    return result;
}

int fsync(int descriptor) { return synced(descriptor, SYS_fsync); }

int fdatasync(int descriptor) { return synced(descriptor, SYS_fdatasync); }

long shim_writes_left(void) { return writes_left; }
