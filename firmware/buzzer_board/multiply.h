// The one product that avr-gcc makes slowly, and that every edge waits for: 16 by 32 bits, all 48 of the result.
#pragma once

#include <stdint.h>

struct Product48 {
    uint32_t high;  // bits 16 to 47
    uint16_t low;   // bits 0 to 15
};

#ifdef __AVR__

inline __attribute__((always_inline)) Product48 multiply(uint16_t a, uint32_t b) {
    Product48 product;
    uint8_t zero;
    asm("clr %[zero]              \n\t"
        "mul %A[a], %A[b]         \n\t"
        "movw %A[low], r0         \n\t"
        "mul %A[a], %C[b]         \n\t"
        "movw %A[high], r0        \n\t"
        "mul %B[a], %D[b]         \n\t"
        "movw %C[high], r0        \n\t"
        "mul %A[a], %B[b]         \n\t"
        "add %B[low], r0          \n\t"
        "adc %A[high], r1         \n\t"
        "adc %B[high], %[zero]    \n\t"
        "adc %C[high], %[zero]    \n\t"
        "adc %D[high], %[zero]    \n\t"
        "mul %B[a], %A[b]         \n\t"
        "add %B[low], r0          \n\t"
        "adc %A[high], r1         \n\t"
        "adc %B[high], %[zero]    \n\t"
        "adc %C[high], %[zero]    \n\t"
        "adc %D[high], %[zero]    \n\t"
        "mul %B[a], %B[b]         \n\t"
        "add %A[high], r0         \n\t"
        "adc %B[high], r1         \n\t"
        "adc %C[high], %[zero]    \n\t"
        "adc %D[high], %[zero]    \n\t"
        "mul %A[a], %D[b]         \n\t"
        "add %B[high], r0         \n\t"
        "adc %C[high], r1         \n\t"
        "adc %D[high], %[zero]    \n\t"
        "mul %B[a], %C[b]         \n\t"
        "add %B[high], r0         \n\t"
        "adc %C[high], r1         \n\t"
        "adc %D[high], %[zero]    \n\t"
        "clr r1                   \n\t"
        : [high] "=&r"(product.high), [low] "=&r"(product.low), [zero] "=&r"(zero)
        : [a] "r"(a), [b] "r"(b)
        : "r0");
    return product;
}

#else

inline Product48 multiply(uint16_t a, uint32_t b) {
    const uint64_t product = (uint64_t)a * b;
    return {(uint32_t)(product >> 16), (uint16_t)product};
}

#endif
