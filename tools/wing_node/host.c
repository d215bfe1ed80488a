/* The wing node on a PC, for tests and for a bench without a wing.
 * Arguments: a terminal, or the number of an open file (the master of a pseudo-terminal); component; readings a second;
 * readings averaged; ppm by which the clock is fast; pause in ms that the main loop takes once a second.
 * The first line on standard output is the truth: CLOCK_MONOTONIC in ns at which the node's clock was 0. */
#define _GNU_SOURCE
#include "node.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define FIFO 64u /* readings; an ICM-42688-P holds 128 of 16 bytes */
#define SHAKE_HZ 5.0
#define SHAKE_MPS2 3.0

static int port;
static uint64_t start_ns;
static double skew, rate_hz;
static uint64_t made, given; /* readings made by the sensor, and taken from it or lost */
static uint32_t lost;

static uint64_t monotonic_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

uint64_t hal_now_us(void) { return (uint64_t)((double)(monotonic_ns() - start_ns) * (1.0 + skew) / 1000.0); }

/* The sensor runs on by itself; a reading that finds the FIFO full takes the place of the oldest. */
static void run_sensor(void) {
    made = (uint64_t)((double)hal_now_us() * 1e-6 * rate_hz);
    if (made - given > FIFO) {
        lost += (uint32_t)(made - given - FIFO);
        given = made - FIFO;
    }
}

int hal_take_sample(node_sample *sample) {
    run_sensor();
    if (given == made) return 0;
    double t_s = ((double)given + 0.5) / rate_hz;
    given++;
    sample->t_us = (uint64_t)(t_s * 1e6 + 0.5);
    for (int i = 0; i < 3; i++) sample->accel_mps2[i] = sample->gyro_radps[i] = 0.0f;
    sample->accel_mps2[2] = (float)(-9.80665 + SHAKE_MPS2 * sin(2.0 * M_PI * SHAKE_HZ * t_s));
    sample->gyro_radps[0] = (float)(0.1 * cos(2.0 * M_PI * SHAKE_HZ * t_s));
    return 1;
}

uint32_t hal_samples_lost(void) {
    run_sensor();
    return lost;
}

size_t hal_write(const uint8_t *bytes, size_t length) {
    ssize_t written = write(port, bytes, length);
    if (written < 0 && errno != EAGAIN) exit(1);
    return written < 0 ? 0 : (size_t)written;
}

static double argument(int count, char **words, int place, double other) {
    return count > place ? atof(words[place]) : other;
}

static void pause_ms(double milliseconds) {
    struct timespec time = {0, (long)(milliseconds * 1e6)};
    nanosleep(&time, NULL);
}

int main(int count, char **words) {
    if (count < 2) return 2;
    port = words[1][0] == '/' ? open(words[1], O_RDWR | O_NOCTTY) : atoi(words[1]);
    if (port < 0) return 1;
    fcntl(port, F_SETFL, fcntl(port, F_GETFL) | O_NONBLOCK);
    node_settings settings = {1, (uint8_t)argument(count, words, 2, 200), (uint8_t)argument(count, words, 4, 1)};
    rate_hz = argument(count, words, 3, 1000);
    skew = argument(count, words, 5, 0) * 1e-6;
    double stall_ms = argument(count, words, 6, 0);
    struct termios raw;
    tcgetattr(port, &raw);
    cfmakeraw(&raw);
    tcsetattr(port, TCSANOW, &raw);
    start_ns = monotonic_ns();
    printf("%llu\n", (unsigned long long)start_ns);
    fflush(stdout);
    node n;
    node_init(&n, settings);
    uint64_t stall_at_us = 1000000u;
    for (;;) {
        struct pollfd one = {port, POLLIN, 0};
        if (poll(&one, 1, 0) > 0) {
            uint8_t bytes[256];
            ssize_t length = read(port, bytes, sizeof bytes);
            if (length <= 0) return 0;
            for (ssize_t i = 0; i < length; i++) node_receive(&n, bytes[i]);
        }
        node_service(&n);
        if (stall_ms > 0 && hal_now_us() >= stall_at_us) {
            stall_at_us += 1000000u;
            pause_ms(stall_ms);
        }
        pause_ms(0.1);
    }
}
