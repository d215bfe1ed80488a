/* Wing node: the part that does not know its hardware. See README.md. */
#ifndef SPANWISE_NODE_H
#define SPANWISE_NODE_H

#include <stddef.h>
#include <stdint.h>

#define NODE_QUEUE 32u       /* samples that wait for the line; a power of two */
#define NODE_LINE_BYTES 280u /* the longest MAVLink frame */
#define NODE_FRAME_BYTES 80u

/* One reading of the inertial sensor. t_us: the middle of its averaging window, on the node's clock. */
typedef struct {
    uint64_t t_us;
    float accel_mps2[3];
    float gyro_radps[3];
} node_sample;

/* What the hardware has to do; one implementation per microcontroller, one for a PC (host.c). */
uint64_t hal_now_us(void);
int hal_take_sample(node_sample *sample);             /* 1: the oldest of the sensor's FIFO; 0: it is empty */
uint32_t hal_samples_lost(void);                      /* readings that the FIFO had no room for, since the start */
size_t hal_write(const uint8_t *bytes, size_t length); /* what the line takes at once, and no waiting for more */

typedef struct {
    uint8_t system;
    uint8_t component; /* 200 left, 201 right */
    uint8_t average;   /* readings that make one sample: 1 sends every one */
} node_settings;

typedef struct {
    uint32_t loop_lost; /* readings lost because node_service was called too late */
    uint32_t line_lost; /* readings lost because the line is too slow */
    uint32_t answers;   /* TIMESYNC requests answered */
    uint32_t damaged;   /* TIMESYNC frames with a wrong checksum */
} node_counters;

typedef struct {
    node_settings settings;
    node_counters counters;
    /* from the sensor to the line */
    double sums[6], stamps;
    uint64_t first_stamp_us;
    unsigned summed;
    uint32_t lost_before;
    node_sample queue[NODE_QUEUE];
    unsigned put, taken; /* running counts */
    /* the frame that is leaving */
    uint8_t frame[NODE_FRAME_BYTES];
    size_t length, left;
    uint8_t sequence;
    /* what is due beside samples */
    int asked; /* a TIMESYNC request waits to be answered */
    uint8_t asker[2];
    int64_t asked_ts1;
    uint64_t next_second_us;
    unsigned news; /* heartbeat and counters that are still to be told in this second */
    /* what came in */
    uint8_t line[NODE_LINE_BYTES];
    size_t filled;
} node;

void node_init(node *n, node_settings settings);
void node_receive(node *n, uint8_t byte);
/* Call as often as possible: empties the sensor's FIFO, keeps the heartbeat, feeds the line. */
void node_service(node *n);

#endif
