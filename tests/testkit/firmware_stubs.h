/* What the sketches of docs/firmware-logger call, on this computer: a part that reads as a board at rest, a clock that runs when it
 * is waited for, and an end after READINGS readings. */
#ifndef FIRMWARE_STUBS_H
#define FIRMWARE_STUBS_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#ifndef READINGS
#define READINGS 300
#endif

static uint8_t written[256];
static int64_t clock_us = 4000000; /* since power-on */
static long bursts;

static void burst(uint8_t reg, uint8_t *bytes, size_t size) {
    static const int16_t rest[7] = {150, -90, 16300, -3920, -120, 60, 30}; /* accelerometers, temperature, gyroscopes */
    if (reg != 0x3B || size != 14 || written[0x6B] != 1 || written[0x1A] != 3) exit(3);
    if (bursts == READINGS) exit(0);
    for (int i = 0; i < 7; i++) {
        int16_t value = (int16_t)(rest[i] + (bursts * (i % 5 + 1)) % 7 - 3);
        bytes[2 * i] = (uint8_t)((uint16_t)value >> 8);
        bytes[2 * i + 1] = (uint8_t)value;
    }
    bursts++;
    clock_us += 300; /* the bus is not infinitely quick */
}
#endif
