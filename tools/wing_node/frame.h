/* MAVLink 2 frames, written out by hand for the four messages that a wing node speaks. */
#ifndef SPANWISE_FRAME_H
#define SPANWISE_FRAME_H

#include <stddef.h>
#include <stdint.h>

#define TIMESYNC_ID 111u

uint16_t frame_checksum(const uint8_t *bytes, size_t length, uint8_t extra);

/* Each writes one frame and gives its length. head: sequence, system, component. */
size_t frame_heartbeat(uint8_t *out, const uint8_t head[3]);
size_t frame_highres_imu(uint8_t *out, const uint8_t head[3], uint64_t t_us, const float accel[3],
                         const float gyro[3]);
size_t frame_timesync(uint8_t *out, const uint8_t head[3], int64_t tc1, int64_t ts1, const uint8_t to[2]);
size_t frame_named_int(uint8_t *out, const uint8_t head[3], uint32_t time_ms, const char *name, int32_t value);

/* Reads a TIMESYNC of either protocol version from the start of the bytes.
 * 1: it is one; 0: more bytes are needed; -1: no TIMESYNC begins here; -2: its checksum is wrong. */
int frame_read_timesync(const uint8_t *bytes, size_t length, int64_t *tc1, int64_t *ts1, uint8_t from[2], uint8_t to[2],
                        size_t *used);

#endif
