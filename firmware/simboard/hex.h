// Intel hex files, as compilers and boot loaders come in.
#pragma once

#include <stdbool.h>
#include <stdint.h>

struct hex_image {
    uint8_t *bytes;
    bool *is_set;  // whether the file says what this byte is
    uint32_t lowest, highest;
};

// False when it is no such file or holds nothing.
bool hex_read(const char *path, struct hex_image *image);
void hex_free(struct hex_image *image);
