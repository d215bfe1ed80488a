/* A stream of samples and its averages over epochs, as plain pointers: see core/tracking/streams.py. */
#ifndef SPANWISE_STREAMS_H
#define SPANWISE_STREAMS_H

#include "arrays.h"

enum { VERTICAL = 2, CHANNELS = 6 };

/* StreamSamples of streams.py. */
typedef struct {
    const array *t_ns, *values;
    double rate_hz;
    const array *cutoff_hz;
    int64_t filtered;
} stream_record;

/* EpochAverages of streams.py. */
typedef struct {
    const array *mean, *moment, *aliasing_noise, *covered, *resolved;
} averages_record;

typedef struct {
    const int64_t *t_ns;
    const double *values, *cutoff_hz;
    double rate_hz;
    int64_t length;
    bool filtered;
} stream;

typedef struct {
    double *mean, *moment, *aliasing_noise;
    uint8_t *covered, *resolved;
} averages;

/* Pointers of a record; BAD_ARRAY where an array is not as declared. */
int64_t read_stream(const stream_record *record, stream *out);

/* Averages over the epochs between n + 1 equally spaced edges. */
int64_t average_stream(const stream *samples, const int64_t *edges_ns, int64_t n, averages *out);

#endif
