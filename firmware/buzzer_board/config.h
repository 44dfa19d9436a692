// What is soldered where, and how far the board may go. This is the file to change for another board.
#pragma once

#include <stdint.h>

// Arduino pin numbers. Buzzer 1 is the first of them; each drives one passive piezo through its resistor to ground.
constexpr uint8_t BUZZER_PINS[] = {2, 3, 4, 5, 6, 7};
constexpr uint8_t LED_PIN = 13;  // on exactly while a buzzer sounds
constexpr uint8_t NO_PIN = 255;
constexpr uint8_t SYNC_PIN = 8;  // follows the wave of whichever buzzer sounds; NO_PIN for none

#define FIRMWARE_NAME "buzzer-board"
#define FIRMWARE_VERSION "1.0.0"
#define PROTOCOL_VERSION "1"

#if defined(ARDUINO_AVR_UNO)
#define BOARD_NAME "uno"
#elif defined(ARDUINO_AVR_NANO)
#define BOARD_NAME "nano"
#elif defined(ARDUINO_AVR_MEGA2560)
#define BOARD_NAME "mega"
#else
#define BOARD_NAME "other"
#endif

constexpr uint8_t N_BUZZERS = sizeof BUZZER_PINS;
constexpr uint32_t MIN_HZ = 50, MAX_HZ = 20000;
constexpr uint32_t MIN_CHIP_HZ = 1000, MAX_CHIP_HZ = 20000;
constexpr uint8_t MIN_ORDER = 7, MAX_ORDER = 13;
constexpr uint32_t MIN_DURATION_US = 5000, MAX_DURATION_US = 500000;

static_assert(MAX_DURATION_US <= 500000, "no emission longer than half a second, whatever the host says");
