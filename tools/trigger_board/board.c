#include "board.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static unsigned checksum(const char *text, size_t length) {
    unsigned sum = 0;
    for (size_t i = 0; i < length; i++) sum ^= (unsigned char)text[i];
    return sum;
}

static void answer(const char *text) {
    char whole[BOARD_LINE + 8];
    int length = snprintf(whole, sizeof whole, "%s*%02X\n", text, checksum(text, strlen(text)));
    hal_write(whole, (size_t)length);
}

void board_init(board *b) { memset(b, 0, sizeof *b); }

static void schedule(board *b, unsigned long plan, unsigned long long at_us, unsigned long width_us) {
    char text[BOARD_LINE];
    const char *verdict = "ok";
    if (width_us == 0 || width_us > BOARD_LONGEST_US) verdict = "width";
    else if (at_us <= hal_now_us()) verdict = "late";
    else if (b->queued == BOARD_QUEUE) verdict = "full";
    else {
        unsigned place = b->queued++;
        while (place > 0 && b->queue[place - 1].at_us > at_us) {
            b->queue[place] = b->queue[place - 1];
            place--;
        }
        b->queue[place] = (board_shot){(uint32_t)plan, at_us, (uint32_t)width_us};
    }
    snprintf(text, sizeof text, "f %lu %s", plan, verdict);
    answer(text);
}

static void command(board *b, const char *text, uint64_t received_us) {
    char reply[BOARD_LINE];
    unsigned long id, width_us;
    unsigned long long at_us;
    char end;
    if (sscanf(text, "T %lu%c", &id, &end) == 1) {
        /* two stamps, as in NTP: what happens between them does not count as way */
        snprintf(reply, sizeof reply, "t %lu %llu %llu", id, (unsigned long long)received_us, (unsigned long long)hal_now_us());
        answer(reply);
    } else if (sscanf(text, "F %lu %llu %lu%c", &id, &at_us, &width_us, &end) == 3) {
        schedule(b, id, at_us, width_us);
    } else if (strcmp(text, "C") == 0) {
        b->queued = 0;
        answer("c");
    } else if (strcmp(text, "V") == 0) {
        answer("v spanwise-trigger 1");
    } else {
        answer("! unknown");
    }
}

static void whole_line(board *b, uint64_t received_us) {
    b->line[b->filled] = 0;
    char *star = strrchr(b->line, '*');
    char *end = NULL;
    if (b->overlong || star == NULL || strlen(star) != 3 ||
        strtoul(star + 1, &end, 16) != checksum(b->line, (size_t)(star - b->line)) || *end != 0) {
        answer("! checksum");
        return;
    }
    *star = 0;
    command(b, b->line, received_us);
}

void board_receive(board *b, char byte, uint64_t received_us) {
    if (byte == '\r') return;
    if (byte != '\n') {
        if (b->filled + 1 < BOARD_LINE) b->line[b->filled++] = byte;
        else b->overlong = 1;
        return;
    }
    if (b->filled > 0) whole_line(b, received_us);
    b->filled = 0;
    b->overlong = 0;
}

static void drop_first(board *b) {
    b->queued--;
    memmove(b->queue, b->queue + 1, b->queued * sizeof b->queue[0]);
}

uint64_t board_service(board *b) {
    if (b->high && hal_now_us() >= b->low_at_us) {
        hal_set_line(0);
        b->high = 0;
    }
    if (!b->high && b->queued > 0 && hal_now_us() >= b->queue[0].at_us) {
        char text[BOARD_LINE];
        board_shot shot = b->queue[0];
        hal_set_line(1);
        uint64_t edge_us = hal_now_us();
        b->high = 1;
        b->low_at_us = edge_us + shot.width_us;
        drop_first(b);
        snprintf(text, sizeof text, "E %lu %llu", (unsigned long)shot.plan, (unsigned long long)edge_us);
        answer(text);
    }
    if (b->high) return b->low_at_us;
    return b->queued > 0 ? b->queue[0].at_us : UINT64_MAX;
}
