/* Datagrams that wait in a socket, many by one system call: see adapters/mavlink/link/datagrams.py. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <string.h>
#include <sys/socket.h>

#include "arrays.h"

enum { MAGIC_1 = 0xFE, MAGIC_2 = 0xFD, SHORTEST = 8 };
enum { OTHER, FRAMES, GUARDED_FRAMES };               /* forms of a datagram */
enum { SENDER, START, STOP, FORM, LARGEST, COLUMNS }; /* columns of the table; LARGEST: bytes of its largest datagram */
enum { GUARDED_COLUMNS = 4 };
enum { SLOT = 65536, MOST_AT_ONCE = 64, FAILED = -1000 };

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

/* Read up to so many datagrams: their bytes one behind the other, and a table with a row for each; those that follow
 * each other from one sender, all of whole frames without a guarded id, share a row. How many datagrams there were in
 * the upper, how many rows in the lower 32 bits; FAILED - errno where the socket fails. */
EXPORT int64_t datagrams_read(int64_t descriptor, const array *buffer_out, int64_t most_datagrams,
                              const array *guarded_in, int64_t system, const array *table_out)
{
    bool good = true;
    uint8_t *buffer = bytes(buffer_out, &good);
    const uint8_t *guarded = truths(guarded_in, 1, &good);
    int64_t *table = integers(table_out, 2, &good);
    if (!good || most_datagrams < 1 || most_datagrams > MOST_AT_ONCE || extent(guarded_in, 0) != 256 ||
        extent(buffer_out, 0) < most_datagrams * SLOT || extent(table_out, 0) < most_datagrams ||
        extent(table_out, 1) != COLUMNS)
        return BAD_ARRAY;
    struct sockaddr_in senders[MOST_AT_ONCE];
    int64_t sizes[MOST_AT_ONCE], rows = 0, filled = 0;
    memset(senders, 0, sizeof senders);
    int64_t count = receive((int)descriptor, buffer, most_datagrams, senders, sizes);
    if (count < 0)
        return count == -EAGAIN || count == -EWOULDBLOCK ? 0 : FAILED + count;
    for (int64_t k = 0; k < count; k++) {
        int64_t sender = (int64_t)ntohl(senders[k].sin_addr.s_addr) << 16 | ntohs(senders[k].sin_port);
        memmove(buffer + filled, buffer + k * SLOT, (size_t)sizes[k]);
        int64_t among = find_guarded(buffer + filled, sizes[k], guarded, system, NULL);
        int64_t form = among < 0 ? OTHER : among ? GUARDED_FRAMES : FRAMES;
        int64_t *last = table + (rows - 1) * COLUMNS;
        if (rows && form == FRAMES && last[FORM] == FRAMES && last[SENDER] == sender) {
            last[STOP] += sizes[k];
            last[LARGEST] = most_of(last[LARGEST], sizes[k]);
        } else {
            int64_t row[COLUMNS] = {sender, filled, filled + sizes[k], form, sizes[k]};
            memcpy(table + rows++ * COLUMNS, row, sizeof row);
        }
        filled += sizes[k];
    }
    return count << 32 | rows;
}
