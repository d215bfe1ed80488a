/* Datagrams that wait in a socket, all by one call: see adapters/mavlink/link/datagrams.py. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <string.h>
#include <sys/socket.h>

#include "arrays.h"

enum { MAGIC_1 = 0xFE, MAGIC_2 = 0xFD, SHORTEST = 8 };
enum { OTHER, FRAMES, GUARDED_FRAMES };               /* forms of a datagram */
enum { SENDER, START, STOP, FORM, COLUMNS };          /* columns of the table */
enum { LARGEST, DRAINED, STATES };
enum { GUARDED_COLUMNS = 4 };
enum { SLOT = 65536, MOST_AT_ONCE = 64, MOST_BATCHES = 64, FAILED = -1000 };

/* Walk over whole frames by their headers: start, stop, system and component of those with a guarded id into the rows,
 * where there are rows. How many there are; -1 where the bytes are not whole frames. */
static int64_t find_guarded(const uint8_t *data, int64_t end, const uint8_t *guarded, int64_t system, int64_t *rows)
{
    int64_t at = 0, count = 0;
    while (at + SHORTEST <= end) {
        bool newer = data[at] == MAGIC_2;
        if (!newer && data[at] != MAGIC_1)
            return -1;
        const uint8_t *key = data + at + (newer ? 5 : 3);
        int64_t start = at;
        at += newer ? 12 + data[at + 1] + (data[at + 2] & 1 ? 13 : 0) : 8 + data[at + 1];
        if (guarded[key[1]] && (system < 0 || key[0] == system)) {
            int64_t row[GUARDED_COLUMNS] = {start, at, key[0], key[1]};
            if (rows)
                memcpy(rows + count * GUARDED_COLUMNS, row, sizeof row);
            count++;
        }
    }
    return at == end ? count : -1;
}

/* Frames with a guarded id in bytes of the form GUARDED_FRAMES, a row each; how many. */
EXPORT int64_t datagram_guarded(const array *data_in, const array *guarded_in, int64_t system, const array *rows_out)
{
    bool good = true;
    const uint8_t *data = bytes(data_in, &good), *guarded = truths(guarded_in, 1, &good);
    int64_t *rows = integers(rows_out, 2, &good), end = extent(data_in, 0);
    if (!good || extent(guarded_in, 0) != 256 || extent(rows_out, 1) != GUARDED_COLUMNS ||
        extent(rows_out, 0) < end / SHORTEST)
        return BAD_ARRAY;
    return find_guarded(data, end, guarded, system, rows);
}

/* Receive up to so many datagrams into slots of the buffer, with their senders; how many, or -errno. */
static int64_t receive(int descriptor, uint8_t *buffer, int64_t most_datagrams, struct sockaddr_in *senders,
                       int64_t *sizes)
{
#ifdef __linux__
    struct mmsghdr messages[MOST_AT_ONCE];
    struct iovec slots[MOST_AT_ONCE];
    memset(messages, 0, (size_t)most_datagrams * sizeof *messages);
    for (int64_t k = 0; k < most_datagrams; k++) {
        slots[k] = (struct iovec){buffer + k * SLOT, SLOT};
        messages[k].msg_hdr.msg_name = senders + k;
        messages[k].msg_hdr.msg_namelen = sizeof *senders;
        messages[k].msg_hdr.msg_iov = slots + k;
        messages[k].msg_hdr.msg_iovlen = 1;
    }
    int count = recvmmsg(descriptor, messages, (unsigned)most_datagrams, MSG_DONTWAIT, NULL);
    for (int k = 0; k < count; k++)
        sizes[k] = messages[k].msg_len;
    return count < 0 ? -errno : count;
#else
    (void)most_datagrams;
    socklen_t length = sizeof *senders;
    ssize_t size = recvfrom(descriptor, buffer, SLOT, MSG_DONTWAIT, (struct sockaddr *)senders, &length);
    sizes[0] = size;
    return size < 0 ? -errno : 1;
#endif
}

/* Append a batch of datagrams in their slots: bytes behind those so far, rows to the table. Bytes in all, then. */
static int64_t append(uint8_t *buffer, int64_t filled, const uint8_t *slots, const struct sockaddr_in *senders,
                      const int64_t *sizes, int64_t count, const uint8_t *guarded, int64_t system, int64_t *table,
                      int64_t *rows)
{
    for (int64_t k = 0; k < count; k++) {
        int64_t sender = (int64_t)ntohl(senders[k].sin_addr.s_addr) << 16 | ntohs(senders[k].sin_port);
        memcpy(buffer + filled, slots + k * SLOT, (size_t)sizes[k]);
        int64_t among = find_guarded(buffer + filled, sizes[k], guarded, system, NULL);
        int64_t form = among < 0 ? OTHER : among ? GUARDED_FRAMES : FRAMES;
        int64_t *last = table + (*rows - 1) * COLUMNS;
        if (*rows && form == FRAMES && last[FORM] == FRAMES && last[SENDER] == sender) {
            last[STOP] += sizes[k];
        } else {
            int64_t row[COLUMNS] = {sender, filled, filled + sizes[k], form};
            memcpy(table + (*rows)++ * COLUMNS, row, sizeof row);
        }
        filled += sizes[k];
    }
    return filled;
}

/* Read what waits, about so many bytes at most: the datagrams' bytes one behind the other in the first buffer, and a
 * table with a row for each; those that follow each other from one sender, all of whole frames without a guarded id,
 * share a row. `state` has the size of the largest datagram of the last system call, which bounds the next, and
 * whether nothing was left behind. How many rows there are; FAILED - errno where the socket fails before anything is
 * read. */
EXPORT int64_t datagrams_read(int64_t descriptor, int64_t limit, const array *buffer_out, const array *slots_out,
                              const array *guarded_in, int64_t system, const array *table_out, const array *state_out)
{
    bool good = true;
    uint8_t *buffer = bytes(buffer_out, &good), *slots = bytes(slots_out, &good);
    const uint8_t *guarded = truths(guarded_in, 1, &good);
    int64_t *table = integers(table_out, 2, &good), *state = integers(state_out, 1, &good);
    int64_t most_at_once = extent(slots_out, 0) / SLOT, most_rows = extent(table_out, 0) - most_at_once;
    if (!good || most_at_once < 1 || most_at_once > MOST_AT_ONCE || extent(guarded_in, 0) != 256 ||
        extent(buffer_out, 0) < limit + extent(slots_out, 0) || most_rows < 0 || extent(table_out, 1) != COLUMNS ||
        extent(state_out, 0) != STATES)
        return BAD_ARRAY;
    struct sockaddr_in senders[MOST_AT_ONCE];
    int64_t sizes[MOST_AT_ONCE], rows = 0, filled = 0, largest = most_of(state[LARGEST], 1);
    memset(senders, 0, sizeof senders);
    state[DRAINED] = 0;
    for (int64_t batch = 0; batch < MOST_BATCHES && filled < most_of(limit, 1) && rows <= most_rows; batch++) {
        int64_t asked = least_of(most_of((limit - filled) / largest, 1), most_at_once);
        int64_t count = receive((int)descriptor, slots, asked, senders, sizes);
        bool empty = count == -EAGAIN || count == -EWOULDBLOCK;
        if (count < 0 && !empty) {
            if (!batch)
                return FAILED + count;
            break; /* what was read before it comes first; one that stays is told by the next read */
        }
        filled = append(buffer, filled, slots, senders, sizes, most_of(count, 0), guarded, system, table, &rows);
        for (int64_t k = 0; k < count; k++)
            largest = k ? most_of(largest, sizes[k]) : most_of(sizes[k], 1);
        if (count < asked) {
            state[DRAINED] = 1;
            break;
        }
    }
    state[LARGEST] = largest;
    return rows;
}
