/* Frames of MAVLink in a buffer, and the samples of plain inertial messages: see adapters/mavlink/decode/bulk.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"

enum { MAGIC_1 = 0xFE, MAGIC_2 = 0xFD, SHORTEST = 8, LARGEST = 255, AXES = 6, AT_ONCE = 8 };
enum { HIGHRES, RAW, SCALED };
enum { FRAMES = 1, CRC_ERRORS, UNKNOWN, SKIPPED_BYTES, COUNTED }; /* places in the counts; the position is the first */
enum { SENDER, LAYOUT, ORDER, NUMBERS = ORDER + AXES };           /* columns of the sources */

typedef struct {
    int64_t key, first, stop, start; /* of the payload the first byte and the one behind it; the frame's first byte */
} span;

typedef struct {
    const array *crc;     /* (AT_ONCE, 256) */
    const array *extra;   /* (ids,) */
    const array *longest; /* (256,) */
    int64_t limit_us;
    const array *number; /* (sources, NUMBERS) */
    const array *factor; /* (sources, AXES) */
} plan;

typedef struct {
    const int64_t *crc, *extra, *longest;
    int64_t ids;
} tables;

static int64_t checksum(const uint8_t *buffer, int64_t first, int64_t stop, const int64_t *crc_table)
{
    int64_t crc = 0xFFFF, k = first;
    const int64_t *alone = crc_table, *followed = crc_table + (AT_ONCE - 1) * 256; /* by zeros for the rest */
    for (; k + AT_ONCE <= stop; k += AT_ONCE) {
        int64_t sum = followed[(crc ^ buffer[k]) & 255] ^ followed[-256 + ((crc >> 8) ^ buffer[k + 1])];
        for (int64_t byte = 2; byte < AT_ONCE; byte++)
            sum ^= followed[-256 * byte + buffer[k + byte]];
        crc = sum;
    }
    for (; k < stop; k++)
        crc = (crc >> 8) ^ alone[(crc ^ buffer[k]) & 255];
    return crc;
}

/* The walk over a buffer until there are `most_spans`; the first byte that has to wait for more, or is not read yet. */
static int64_t find_frames(const uint8_t *buffer, int64_t end, const tables *known, span *spans, int64_t most_spans,
                           int64_t *counted)
{
    int64_t position = 0;
    while (position < end && counted[FRAMES] < most_spans) {
        bool newer = buffer[position] == MAGIC_2;
        if (!newer && buffer[position] != MAGIC_1) {
            counted[SKIPPED_BYTES]++;
            position++;
            continue;
        }
        int64_t first = position + (newer ? 10 : 6), key = 0, named = newer ? 5 : 3;
        if (first > end)
            break;
        int64_t flags = newer ? buffer[position + 2] : 0;
        for (int64_t k = 0; k < named; k++)
            key |= (int64_t)buffer[first - named + k] << (8 * k);
        int64_t extra = key >> 16 < known->ids ? known->extra[key >> 16] : -1;
        if (flags > 1 || extra < 0) {
            counted[UNKNOWN] += flags <= 1;
            counted[SKIPPED_BYTES]++;
            position++;
            continue;
        }
        int64_t stop = first + buffer[position + 1], after = stop + (flags ? 15 : 2);
        if (after > end)
            break;
        bool intact = newer || buffer[position + 1] <= known->longest[key >> 16];
        if (intact) {
            int64_t crc = checksum(buffer, position + 1, stop, known->crc);
            crc = (crc >> 8) ^ known->crc[(crc ^ extra) & 255];
            intact = crc == (buffer[stop] | (int64_t)buffer[stop + 1] << 8);
        }
        if (!intact) {
            counted[CRC_ERRORS]++;
            counted[SKIPPED_BYTES]++;
            position++;
            continue;
        }
        spans[counted[FRAMES]++] = (span){key, first, stop, position};
        position = after;
    }
    return position;
}

/* Stamp in ns and raw values of one payload, which is filled up with zeros; -1 where it is odd. */
static int64_t read_sample(int64_t layout, const uint8_t *payload, int64_t limit_us, double *raw)
{
    if (layout == SCALED) {
        uint32_t stamp_ms;
        int16_t counts[AXES];
        memcpy(&stamp_ms, payload, sizeof stamp_ms);
        memcpy(counts, payload + 4, sizeof counts);
        for (int axis = 0; axis < AXES; axis++)
            raw[axis] = counts[axis];
        return (int64_t)stamp_ms * 1000000;
    }
    uint64_t stamp_us;
    memcpy(&stamp_us, payload, sizeof stamp_us);
    bool odd;
    if (layout == RAW) {
        int16_t counts[AXES];
        memcpy(counts, payload + 8, sizeof counts);
        for (int axis = 0; axis < AXES; axis++)
            raw[axis] = counts[axis];
        odd = payload[26] != 0;
    } else {
        float numbers[AXES];
        memcpy(numbers, payload + 8, sizeof numbers);
        for (int axis = 0; axis < AXES; axis++)
            raw[axis] = numbers[axis];
        odd = payload[62] != 0 || (payload[60] & 63) != 63;
    }
    return odd || stamp_us >= (uint64_t)limit_us ? -1 : (int64_t)stamp_us * 1000;
}

/* Samples of one source; false where one of them is odd. */
static bool read_source(const uint8_t *buffer, const span *spans, const int64_t *of, int64_t count, int64_t source,
                        const int64_t *number, const double *factor, int64_t limit_us, int64_t *t_ns, double *values)
{
    uint8_t payload[LARGEST + 1];
    double raw[AXES];
    for (int64_t k = 0; k < count; k++) {
        if (of[k] != source)
            continue;
        size_t length = (size_t)(spans[k].stop - spans[k].first);
        memcpy(payload, buffer + spans[k].first, length);
        memset(payload + length, 0, sizeof payload - length); /* trailing zeros are not sent */
        if ((*t_ns = read_sample(number[LAYOUT], payload, limit_us, raw)) < 0)
            return false;
        t_ns++;
        for (int axis = 0; axis < AXES; axis++) {
            double value = factor[axis] != 0.0 ? raw[number[ORDER + axis]] * factor[axis] : 0.0;
            if (!isfinite(value))
                return false;
            *values++ = value;
        }
    }
    return true;
}

/* Which source each frame is of, or -1, and how many frames each has. */
static void sort_frames(const span *spans, int64_t count, int64_t system, const int64_t *number, int64_t sources,
                        int64_t *of, int64_t *rows)
{
    for (int64_t source = 0; source < sources; source++)
        rows[source] = 0;
    for (int64_t k = 0; k < count; k++) {
        of[k] = -1;
        if ((spans[k].key & 0xFF) != system)
            continue;
        for (int64_t source = 0; source < sources; source++)
            if ((spans[k].key & ~(int64_t)0xFF) == number[source * NUMBERS + SENDER]) {
                of[k] = source;
                rows[source]++;
            }
    }
}

static void note_source(const int64_t *t_ns, int64_t rows, int64_t *counts)
{
    counts[0] = rows;
    counts[1] = counts[2] = t_ns[0];
    for (int64_t k = 1; k < rows; k++) {
        counts[1] = least_of(counts[1], t_ns[k]);
        counts[2] = most_of(counts[2], t_ns[k]);
    }
}

/* Read a buffer; how many numbers there are in `counts`: the position and counts; number, oldest and newest stamp of
 * each source's samples; then key, start and end of every payload that is not among these. */
EXPORT int64_t mavlink_read(const array *buffer_in, int64_t system, const plan *plan, const array *counts_out,
                            const array *t_ns_out, const array *values_out)
{
    bool good = true;
    const uint8_t *buffer = bytes(buffer_in, &good);
    const tables known = {integers(plan->crc, 2, &good), integers(plan->extra, 1, &good),
                          integers(plan->longest, 1, &good), extent(plan->extra, 0)};
    const int64_t *number = integers(plan->number, 2, &good);
    const double *factor = reals(plan->factor, 2, &good);
    int64_t *counts = integers(counts_out, 1, &good), *t_ns = integers(t_ns_out, 1, &good);
    double *values = reals(values_out, 2, &good);
    int64_t end = extent(buffer_in, 0), sources = extent(plan->number, 0), room = end / SHORTEST;
    if (!good || extent(t_ns_out, 0) < room || extent(values_out, 0) < room ||
        extent(counts_out, 0) < COUNTED + 3 * (sources + room))
        return BAD_ARRAY;
    memset(counts, 0, (size_t)(COUNTED + 3 * sources) * sizeof *counts);
    if (room == 0) /* no frame is that short */
        return COUNTED + 3 * sources;
    span *spans = malloc((size_t)room * sizeof *spans + (size_t)(room + sources) * sizeof(int64_t));
    if (!spans)
        return NO_MEMORY;
    int64_t *of = (int64_t *)(spans + room), *rows = of + room, at = COUNTED;
    counts[0] = find_frames(buffer, end, &known, spans, room, counts);
    int64_t count = counts[FRAMES];
    sort_frames(spans, count, system, number, sources, of, rows);
    for (int64_t source = 0; source < sources; source++, at += 3) {
        if (rows[source] && read_source(buffer, spans, of, count, source, number + source * NUMBERS,
                                        factor + source * AXES, plan->limit_us, t_ns, values)) {
            note_source(t_ns, rows[source], counts + at);
            t_ns += rows[source];
            values += AXES * rows[source];
        } else {
            rows[source] = 0;
        }
    }
    for (int64_t k = 0; k < count; k++)
        if (of[k] < 0 || !rows[of[k]]) {
            counts[at++] = spans[k].key;
            counts[at++] = spans[k].first;
            counts[at++] = spans[k].stop;
        }
    free(spans);
    return at;
}

/* The next place with a whole frame, or one that is not complete; the end where there is none. */
EXPORT int64_t mavlink_seek(const array *buffer_in, const array *crc, const array *extra, const array *longest)
{
    bool good = true;
    const uint8_t *buffer = bytes(buffer_in, &good);
    const tables known = {integers(crc, 2, &good), integers(extra, 1, &good), integers(longest, 1, &good),
                          extent(extra, 0)};
    if (!good)
        return BAD_ARRAY;
    span frame;
    int64_t counted[COUNTED] = {0}, position = find_frames(buffer, extent(buffer_in, 0), &known, &frame, 1, counted);
    return counted[FRAMES] ? frame.start : position;
}
