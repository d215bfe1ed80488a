#include "node.h"

#include <string.h>

#include "frame.h"

#define SECOND_US 1000000u

void node_init(node *n, node_settings settings) {
    memset(n, 0, sizeof *n);
    n->settings = settings;
    if (n->settings.average == 0) n->settings.average = 1;
}

/* ---------------------------------------------------------------------------------------- from the sensor */

static int queue_full(const node *n) { return n->put - n->taken == NODE_QUEUE; }

static void queue_mean(node *n) {
    node_sample *mean = &n->queue[n->put++ % NODE_QUEUE];
    mean->t_us = n->first_stamp_us + (uint64_t)(n->stamps / n->summed + 0.5);
    for (int i = 0; i < 3; i++) {
        mean->accel_mps2[i] = (float)(n->sums[i] / n->summed);
        mean->gyro_radps[i] = (float)(n->sums[3 + i] / n->summed);
    }
    memset(n->sums, 0, sizeof n->sums);
    n->stamps = 0.0;
    n->summed = 0;
}

/* What finds no room in the queue stays in the sensor's FIFO, so that readings are lost in one place alone. */
static void take_samples(node *n) {
    node_sample sample;
    while (!queue_full(n) && hal_take_sample(&sample)) {
        if (n->summed == 0) n->first_stamp_us = sample.t_us;
        n->stamps += (double)(sample.t_us - n->first_stamp_us);
        for (int i = 0; i < 3; i++) {
            n->sums[i] += sample.accel_mps2[i];
            n->sums[3 + i] += sample.gyro_radps[i];
        }
        if (++n->summed == n->settings.average) queue_mean(n);
    }
}

/* The FIFO ran over because the line held the queue full, or because we were not called in time. */
static void count_losses(node *n) {
    uint32_t lost = hal_samples_lost();
    *(queue_full(n) ? &n->counters.line_lost : &n->counters.loop_lost) += lost - n->lost_before;
    n->lost_before = lost;
}

/* ---------------------------------------------------------------------------------------- to the line */

/* An answer overtakes what waits and is stamped when the line takes it: the shorter its way, the better the clocks are
 * known. Then heartbeat and counters, then the oldest sample. 0: there is nothing to send. */
static size_t next_frame(node *n) {
    uint8_t ids[3] = {n->sequence, n->settings.system, n->settings.component};
    uint32_t now_ms = (uint32_t)(hal_now_us() / 1000u);
    if (n->asked) {
        n->asked = 0;
        n->counters.answers++;
        return frame_timesync(n->frame, ids, (int64_t)hal_now_us() * 1000, n->asked_ts1, n->asker);
    }
    switch (n->news) {
    case 4: n->news--; return frame_heartbeat(n->frame, ids);
    case 3: n->news--; return frame_named_int(n->frame, ids, now_ms, "loop_lost", (int32_t)n->counters.loop_lost);
    case 2: n->news--; return frame_named_int(n->frame, ids, now_ms, "line_lost", (int32_t)n->counters.line_lost);
    case 1: n->news--; return frame_named_int(n->frame, ids, now_ms, "line_bad", (int32_t)n->counters.damaged);
    }
    if (n->put == n->taken) return 0;
    const node_sample *sample = &n->queue[n->taken++ % NODE_QUEUE];
    return frame_highres_imu(n->frame, ids, sample->t_us, sample->accel_mps2, sample->gyro_radps);
}

/* What began to leave leaves whole, before anything else. */
static void feed_line(node *n) {
    for (;;) {
        if (n->left == 0) {
            n->left = n->length = next_frame(n);
            if (n->length == 0) return;
            n->sequence++;
        }
        size_t taken = hal_write(n->frame + n->length - n->left, n->left);
        n->left -= taken;
        if (n->left > 0) return;
    }
}

/* ---------------------------------------------------------------------------------------- from the line */

void node_receive(node *n, uint8_t byte) {
    n->line[n->filled++] = byte;
    size_t from = 0;
    while (from < n->filled) {
        int64_t tc1, ts1;
        uint8_t sender[2], to[2];
        size_t used = 1;
        int found = frame_read_timesync(n->line + from, n->filled - from, &tc1, &ts1, sender, to, &used);
        if (found == 0) break;
        if (found == -2) n->counters.damaged++;
        if (found == 1 && tc1 == 0 && (to[0] == 0 || to[0] == n->settings.system) &&
            (to[1] == 0 || to[1] == n->settings.component)) { /* the newest question alone is worth an answer */
            n->asked = 1;
            n->asked_ts1 = ts1;
            memcpy(n->asker, sender, sizeof n->asker);
        }
        from += used;
    }
    n->filled -= from;
    memmove(n->line, n->line + from, n->filled);
}

void node_service(node *n) {
    count_losses(n);
    take_samples(n);
    if (hal_now_us() >= n->next_second_us) {
        n->next_second_us = hal_now_us() + SECOND_US;
        n->news = 4;
    }
    feed_line(n);
}
