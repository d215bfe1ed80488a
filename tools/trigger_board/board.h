/* Trigger board: the part that does not know its hardware. See README.md for the line protocol. */
#ifndef SPANWISE_BOARD_H
#define SPANWISE_BOARD_H

#include <stddef.h>
#include <stdint.h>

#define BOARD_QUEUE 4
#define BOARD_LINE 80
#define BOARD_LONGEST_US 100000u

/* What the hardware has to do; one implementation per microcontroller, one for a PC (host.c). */
uint64_t hal_now_us(void);
void hal_set_line(int on);
void hal_write(const char *text, size_t length);

typedef struct {
    uint32_t plan;
    uint64_t at_us;
    uint32_t width_us;
} board_shot;

typedef struct {
    char line[BOARD_LINE];
    size_t filled;
    int overlong;
    board_shot queue[BOARD_QUEUE]; /* by time, earliest first */
    unsigned queued;
    int high;
    uint64_t low_at_us;
} board;

void board_init(board *b);
/* One byte from the serial line. received_us: when it came, as near to the wire as the hardware can tell. */
void board_receive(board *b, char byte, uint64_t received_us);
/* Call as often as possible: moves the line. Returns the time of the next thing to do, UINT64_MAX if there is none. */
uint64_t board_service(board *b);

#endif
