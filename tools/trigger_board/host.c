/* The board on a PC. First argument: a terminal, or the number of an open file (the master of a pseudo-terminal); second:
 * how much its clock is fast, in ppm. Every rising edge is told on standard output, in ns of CLOCK_MONOTONIC: the truth. */
#define _GNU_SOURCE
#include "board.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define SPIN_US 300u

static int port;
static uint64_t start_ns;
static double skew; /* of the board's crystal */

static uint64_t monotonic_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

uint64_t hal_now_us(void) { return (uint64_t)((double)(monotonic_ns() - start_ns) * (1.0 + skew) / 1000.0); }

void hal_set_line(int on) {
    if (!on) return;
    printf("%llu\n", (unsigned long long)monotonic_ns());
    fflush(stdout);
}

void hal_write(const char *text, size_t length) {
    while (length > 0) {
        ssize_t written = write(port, text, length);
        if (written <= 0) exit(1);
        text += written;
        length -= (size_t)written;
    }
}

int main(int count, char **words) {
    if (count < 2) return 2;
    port = words[1][0] == '/' ? open(words[1], O_RDWR | O_NOCTTY) : atoi(words[1]);
    if (port < 0) return 1;
    skew = count > 2 ? atof(words[2]) * 1e-6 : 0.0;
    struct termios raw;
    tcgetattr(port, &raw);
    cfmakeraw(&raw);
    tcsetattr(port, TCSANOW, &raw);
    start_ns = monotonic_ns();
    board b;
    board_init(&b);
    for (;;) {
        uint64_t next = board_service(&b), now = hal_now_us();
        uint64_t spare = next > now ? next - now : 0;
        int wait_ms = next == UINT64_MAX ? 1000 : spare > SPIN_US + 1000 ? (int)((spare - SPIN_US) / 1000) : 0;
        struct pollfd one = {port, POLLIN, 0};
        int ready = poll(&one, 1, wait_ms);
        if (ready > 0) {
            char bytes[128];
            uint64_t received = hal_now_us();
            ssize_t length = read(port, bytes, sizeof bytes);
            if (length <= 0) return 0;
            for (ssize_t i = 0; i < length; i++) board_receive(&b, bytes[i], received);
        }
    }
}
