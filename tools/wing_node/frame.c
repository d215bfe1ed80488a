#include "frame.h"

#include <string.h>

#define MAGIC_1 0xFEu
#define MAGIC_2 0xFDu
#define SIGNED 0x01u

uint16_t frame_checksum(const uint8_t *bytes, size_t length, uint8_t extra) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i <= length; i++) { /* CRC-16/MCRF4XX over the bytes and the message's extra one */
        uint8_t mixed = (uint8_t)((i < length ? bytes[i] : extra) ^ (crc & 0xFF));
        mixed ^= (uint8_t)(mixed << 4);
        crc = (uint16_t)((crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4));
    }
    return crc;
}

/* Little endian, whatever the processor is. */
static uint8_t *put(uint8_t *at, uint64_t value, unsigned bytes) {
    for (unsigned i = 0; i < bytes; i++) *at++ = (uint8_t)(value >> (8 * i));
    return at;
}

static uint8_t *put_float(uint8_t *at, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put(at, bits, 4);
}

static uint64_t get(const uint8_t *at, unsigned bytes) {
    uint64_t value = 0;
    for (unsigned i = 0; i < bytes; i++) value |= (uint64_t)at[i] << (8 * i);
    return value;
}

/* The payload stands at out + 10 already. Zeros at its end are not sent, but its first byte always is. */
static size_t framed(uint8_t *out, const uint8_t head[3], uint32_t message, uint8_t extra, size_t length) {
    while (length > 1 && out[10 + length - 1] == 0) length--;
    out[0] = MAGIC_2;
    out[1] = (uint8_t)length;
    out[2] = out[3] = 0;
    memcpy(out + 4, head, 3);
    put(out + 7, message, 3);
    put(out + 10 + length, frame_checksum(out + 1, 9 + length, extra), 2);
    return length + 12;
}

size_t frame_heartbeat(uint8_t *out, const uint8_t head[3]) {
    uint8_t *at = put(out + 10, 0, 4); /* custom_mode */
    at = put(at, 40, 1);               /* MAV_TYPE_IMU */
    at = put(at, 8, 1);                /* MAV_AUTOPILOT_INVALID */
    at = put(at, 0, 1);
    at = put(at, 4, 1); /* MAV_STATE_ACTIVE */
    put(at, 3, 1);
    return framed(out, head, 0, 50, 9);
}

size_t frame_highres_imu(uint8_t *out, const uint8_t head[3], uint64_t t_us, const float accel[3],
                         const float gyro[3]) {
    uint8_t *at = put(out + 10, t_us, 8);
    for (int i = 0; i < 3; i++) at = put_float(at, accel[i]);
    for (int i = 0; i < 3; i++) at = put_float(at, gyro[i]);
    memset(at, 0, 7 * 4); /* magnetometer, pressures, temperature: not ours */
    at = put(at + 7 * 4, 0x3F, 2);
    put(at, 0, 1); /* id */
    return framed(out, head, 105, 93, 63);
}

size_t frame_timesync(uint8_t *out, const uint8_t head[3], int64_t tc1, int64_t ts1, const uint8_t to[2]) {
    uint8_t *at = put(put(out + 10, (uint64_t)tc1, 8), (uint64_t)ts1, 8);
    memcpy(at, to, 2);
    return framed(out, head, TIMESYNC_ID, 34, 18);
}

size_t frame_named_int(uint8_t *out, const uint8_t head[3], uint32_t time_ms, const char *name, int32_t value) {
    uint8_t *at = put(put(out + 10, time_ms, 4), (uint32_t)value, 4);
    memset(at, 0, 10);
    memcpy(at, name, strlen(name) > 10 ? 10 : strlen(name));
    return framed(out, head, 252, 44, 18);
}

int frame_read_timesync(const uint8_t *bytes, size_t length, int64_t *tc1, int64_t *ts1, uint8_t from[2], uint8_t to[2],
                        size_t *used) {
    if (bytes[0] != MAGIC_1 && bytes[0] != MAGIC_2) return -1;
    size_t header = bytes[0] == MAGIC_2 ? 10 : 6;
    if (length < header) return 0;
    uint8_t flags = header == 10 ? bytes[2] : 0;
    uint32_t message = header == 10 ? (uint32_t)get(bytes + 7, 3) : bytes[5];
    if (message != TIMESYNC_ID || (flags & ~SIGNED) || bytes[1] > 18) return -1;
    size_t body = header + bytes[1], whole = body + 2 + (flags & SIGNED ? 13 : 0);
    if (length < whole) return 0;
    if (get(bytes + body, 2) != frame_checksum(bytes + 1, body - 1, 34)) return -2;
    uint8_t payload[18] = {0};
    memcpy(payload, bytes + header, bytes[1]);
    *tc1 = (int64_t)get(payload, 8);
    *ts1 = (int64_t)get(payload + 8, 8);
    memcpy(to, payload + 16, 2);
    memcpy(from, bytes + (header == 10 ? 5 : 3), 2);
    *used = whole;
    return 1;
}
