#include "hex.h"

#include <stdio.h>
#include <stdlib.h>

enum { SIZE = 1 << 18, MOST_BYTES = 255 + 5 };  // of the largest flash; of a record
enum { CONTENT = 0, END = 1, SEGMENT = 2, UPPER_ADDRESS = 4 };  // kinds of records; others name a start address

// The bytes of a record; their number, or 0 where the line is none or its checksum does not fit.
static int record_of(const char *line, uint8_t record[MOST_BYTES]) {
    int n_bytes = 0;
    uint8_t sum = 0;
    unsigned byte;
    if (*line++ != ':') return 0;
    for (; n_bytes < MOST_BYTES && sscanf(line, "%2x", &byte) == 1; line += 2) sum += record[n_bytes++] = (uint8_t)byte;
    return n_bytes >= 5 && n_bytes == record[0] + 5 && sum == 0 ? n_bytes : 0;
}

static bool put(struct hex_image *image, uint32_t address, uint8_t byte) {
    if (address >= SIZE) return false;
    image->bytes[address] = byte;
    image->is_set[address] = true;
    if (address < image->lowest) image->lowest = address;
    if (address > image->highest) image->highest = address;
    return true;
}

static bool read_records(FILE *file, struct hex_image *image) {
    char line[2 * MOST_BYTES + 8];
    uint8_t record[MOST_BYTES];
    uint32_t base = 0;
    while (fgets(line, sizeof line, file)) {
        if (!record_of(line, record)) return false;
        const uint32_t address = base + (uint32_t)(record[1] << 8 | record[2]);
        if (record[3] == END) return true;
        if (record[3] == SEGMENT) base = (uint32_t)(record[4] << 8 | record[5]) << 4;
        if (record[3] == UPPER_ADDRESS) base = (uint32_t)(record[4] << 8 | record[5]) << 16;
        for (int i = 0; record[3] == CONTENT && i < record[0]; i++)
            if (!put(image, address + (uint32_t)i, record[4 + i])) return false;
    }
    return false;  // it ended before its last record
}

bool hex_read(const char *path, struct hex_image *image) {
    *image = (struct hex_image){calloc(SIZE, 1), calloc(SIZE, sizeof(bool)), SIZE, 0};
    FILE *file = fopen(path, "r");
    bool is_good = file && image->bytes && image->is_set && read_records(file, image) && image->lowest < SIZE;
    if (file) fclose(file);
    if (!is_good) hex_free(image);
    return is_good;
}

void hex_free(struct hex_image *image) {
    free(image->bytes);
    free(image->is_set);
}
