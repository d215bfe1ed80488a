/* Averages and first moments of samples over epochs of any phase.
 *
 * An integrating sensor's sample is the average over its own interval, so the running integral is known at the
 * interval's edges; between them it is taken as a cubic (Hermite). Where a source has applied a 2nd-order Butterworth
 * low-pass, the samples themselves are interpolated instead, and the filter is inverted by its differential equation,
 * u = y + (sqrt(2)/w) y' + y''/w^2: the mean of u over an epoch needs y and y' at its ends only. The inverse has
 * no delay, and the sensor's noise, which entered ahead of the filter, comes out white again.
 */
#include "streams.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846
/* derived: variance of a sample interpolated as 2/3, 2/3, -1/6, -1/6 of its neighbours, in units of edge_aliasing */
#define LOST_SAMPLE_VARIANCE (35.0 / 6.0)
#define GAP_PERIODS 3.5             /* chosen: two lost samples are interpolated, more are a gap */
#define MIN_GAP_S 0.012             /* chosen: three epochs of 4 ms; shorter gaps are interpolated at any rate */
#define MOMENT_GAP_PERIODS 1.6      /* derived: a single lost sample leaves a gap of two periods */
#define MOMENT_SAMPLES 2.9          /* chosen: three samples an epoch, less the rate's tolerance, make a first moment */
#define LATE_AFTER_PERIODS 0.4      /* chosen: two samples sent in one go behind a gap */
#define LATE_BEFORE_PERIODS 1.3     /* chosen: as before */
#define SATURATION_MARGIN 0.002     /* chosen: a value within this of the range was clipped */

/* Place of the last knot at or before `x`, kept within 0 and `last`. */
static int64_t knot_before(const double *knots, int64_t count, double x, int64_t last)
{
    int64_t low = 0, high = count; /* the first knot behind x is in [low, high] */
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (knots[middle] <= x)
            low = middle + 1;
        else
            high = middle;
    }
    return most_of(least_of(low - 1, last), 0);
}

/* How many stamps lie before `t_ns`. */
static int64_t stamps_before(const int64_t *stamps, int64_t count, int64_t t_ns)
{
    int64_t low = 0, high = count;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (stamps[middle] < t_ns)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* First moments of the vertical channel; edge k lies at fraction s[k] of the sample at[k]. `room`: 3 (samples + 1). */
static void first_moments(const double *y, int64_t samples, int64_t channels, const double *h, const int64_t *at,
                          const double *s, int64_t epochs, double width, double *room, double *moment)
{
    double *total = room, *level = total + samples + 1, *twice = level + samples + 1;
    const double *z = y + VERTICAL;
    total[0] = twice[0] = 0.0;
    level[0] = z[0];
    level[samples] = z[(samples - 1) * channels];
    for (int64_t i = 0; i < samples; i++)
        total[i + 1] = total[i] + h[i] * z[i * channels];
    for (int64_t i = 1; i < samples; i++)
        level[i] = 0.5 * (z[i * channels] + z[(i - 1) * channels]);
    for (int64_t i = 0; i < samples; i++)
        twice[i + 1] = twice[i] + h[i] * (0.5 * (total[i + 1] + total[i]) + h[i] * (level[i] - level[i + 1]) / 12.0);
    double integral = 0.0, twofold = 0.0;
    for (int64_t k = 0; k <= epochs; k++) {
        int64_t i = at[k];
        double step = h[i], c0 = total[i], c1 = total[i + 1], d0 = level[i] * step, d1 = level[i + 1] * step;
        double c2 = 3.0 * (c1 - c0) - 2.0 * d0 - d1, c3 = 2.0 * (c0 - c1) + d0 + d1, u = s[k];
        double integral_here = c0 + u * (d0 + u * (c2 + u * c3));
        double twofold_here = twice[i] + step * u * (c0 + u * (d0 / 2.0 + u * (c2 / 3.0 + u * c3 / 4.0)));
        if (k)
            moment[k - 1] = (0.5 * (integral_here + integral) - (twofold_here - twofold) / width) / width;
        integral = integral_here;
        twofold = twofold_here;
    }
}

/* Mean of every channel and first moment of the vertical one, from samples that are averages themselves. */
static int64_t average_integrals(const double *t, const double *y, int64_t samples, int64_t channels,
                                 const double *edges, int64_t epochs, double *mean, double *moment)
{
    int64_t parts = epochs + 1;
    double *knots = calloc((size_t)(5 * (samples + 1) + parts * (2 + channels)), sizeof *knots);
    if (!knots)
        return NO_MEMORY;
    double *h = knots + samples + 1, *room = h + samples + 1, *s = room + 3 * (samples + 1), *partial = s + parts;
    int64_t *at = (int64_t *)(partial + parts * channels);
    for (int64_t i = 1; i < samples; i++)
        knots[i] = 0.5 * (t[i] + t[i - 1]);
    knots[0] = 2.0 * t[0] - knots[1];
    knots[samples] = 2.0 * t[samples - 1] - knots[samples - 1];
    for (int64_t i = 0; i < samples; i++)
        h[i] = knots[i + 1] - knots[i];
    for (int64_t k = 0; k < parts; k++) { /* the integral of the sample that an edge cuts, up to there */
        int64_t i = at[k] = knot_before(knots, samples + 1, edges[k], samples - 1);
        double u = s[k] = (edges[k] - knots[i]) / h[i];
        double rise = 0.5 * u * squared(1.0 - u), fall = 0.5 * squared(u) * (u - 1.0);
        double weight = squared(u) * (3.0 - 2.0 * u) + rise + fall;
        const double *here = y + i * channels, *before = y + most_of(i - 1, 0) * channels;
        const double *after = y + least_of(i + 1, samples - 1) * channels;
        for (int64_t c = 0; c < channels; c++)
            partial[k * channels + c] = h[i] * (rise * before[c] + weight * here[c] + fall * after[c]);
    }
    double width = edges[1] - edges[0];
    for (int64_t k = 0; k < epochs; k++) {
        double *out = mean + k * channels;
        for (int64_t c = 0; c < channels; c++)
            out[c] = 0.0;
        for (int64_t i = at[k]; i < at[k + 1]; i++)
            for (int64_t c = 0; c < channels; c++)
                out[c] += h[i] * y[i * channels + c];
        for (int64_t c = 0; c < channels; c++)
            out[c] = (out[c] + partial[(k + 1) * channels + c] - partial[k * channels + c]) / width;
    }
    first_moments(y, samples, channels, h, at, s, epochs, width, room, moment);
    free(knots);
    return 0;
}

/* How many samples are lost behind each; the sum. */
static int64_t count_lost(const double *t, int64_t samples, double period_s, double limit_s, int64_t *lost)
{
    int64_t sum = 0;
    for (int64_t i = 0; i < samples; i++) {
        bool inside = i > 0 && i < samples - 2; /* otherwise there is no slope on one side */
        double gap = inside ? t[i + 1] - t[i] : 0.0;
        lost[i] = inside && gap < limit_s ? most_of((int64_t)rint(gap / period_s) - 1, 0) : 0;
        sum += lost[i];
    }
    return sum;
}

/* Fill the gap behind sample i with cubics. */
static void fill_gap(const double *t, const double *y, int64_t channels, int64_t i, int64_t lost, double *t_out,
                     double *y_out)
{
    double before = t[i] - t[i - 1], here = t[i + 1] - t[i], after = t[i + 2] - t[i + 1];
    for (int64_t j = 1; j <= lost; j++)
        t_out[j - 1] = t[i] + (double)j / ((double)lost + 1.0) * here;
    for (int64_t c = 0; c < channels; c++) {
        const double *at = y + i * channels + c;
        double step = at[channels] - at[0];
        double first = ((at[0] - at[-channels]) / before * squared(here) + step * before) / (before + here);
        double last = ((at[2 * channels] - at[channels]) / after * squared(here) + step * after) / (after + here);
        for (int64_t j = 1; j <= lost; j++) {
            double u = (double)j / ((double)lost + 1.0);
            double bend = 3.0 * step - 2.0 * first - last + u * (first + last - 2.0 * step);
            y_out[(j - 1) * channels + c] = at[0] + u * (first + u * bend);
        }
    }
}

static void fill_gaps(const double *t, const double *y, int64_t samples, int64_t channels, const int64_t *lost,
                      double *t_out, double *y_out)
{
    for (int64_t i = 0, at = 0; i < samples; at += 1 + lost[i], i++) {
        t_out[at] = t[i];
        memcpy(y_out + at * channels, y + i * channels, (size_t)channels * sizeof *y);
        if (lost[i])
            fill_gap(t, y, channels, i, lost[i], t_out + at + 1, y_out + (at + 1) * channels);
    }
}

/* Aliasing noise of each epoch by edges that cut samples: 0 where they fall between two, 1 on average. Inside a sample
 * the path of what it averages is a Brownian bridge, whose variance is u (1 - u) at fraction u. */
static void edge_aliasing(const double *t, int64_t samples, const double *edges, int64_t epochs, double *out)
{
    double before = 0.0;
    for (int64_t k = 0, i = 0; k <= epochs; k++) { /* sample i + 1 lies between its two knots */
        while (i < samples - 3 && 0.5 * (t[i + 2] + t[i + 1]) <= edges[k])
            i++;
        double knot = 0.5 * (t[i + 1] + t[i]), next = 0.5 * (t[i + 2] + t[i + 1]);
        double u = (edges[k] - knot) / (next - knot), bridge = most(6.0 * u * (1.0 - u), 0.0);
        if (k)
            out[k - 1] = 0.5 * (bridge + before);
        before = bridge;
    }
}

/* Add the aliasing noise of each epoch by lost samples: their neighbours say nothing of a white load in the gap. */
static void add_gap_aliasing(const double *t, int64_t samples, const double *edges, int64_t epochs, double period_s,
                             double *out)
{
    for (int64_t i = 0; i + 1 < samples; i++) {
        if (!(t[i + 1] - t[i] > 1.5 * period_s))
            continue;
        double begin = t[i] + 0.5 * period_s, end = t[i + 1] - 0.5 * period_s;
        for (int64_t k = 0; k < epochs; k++) {
            double lost = least(end, edges[k + 1]) - most(begin, edges[k]);
            out[k] += LOST_SAMPLE_VARIANCE * most(lost, 0.0) / period_s;
        }
    }
}

/* Mean of every channel ahead of its 2nd-order Butterworth low-pass; a cut-off of 0 is none. */
static int64_t average_deconvolved(const double *t, const double *y, int64_t samples, int64_t channels,
                                   const double *edges, int64_t epochs, const double *cutoff_hz, double *mean)
{
    double *slope = malloc((size_t)(2 * samples + epochs + 1) * sizeof *slope), width = edges[1] - edges[0];
    if (!slope)
        return NO_MEMORY;
    double *area = slope + samples;
    int64_t *at = (int64_t *)(area + samples);
    for (int64_t k = 0; k <= epochs; k++)
        at[k] = knot_before(t, samples, edges[k], samples - 2);
    for (int64_t c = 0; c < channels; c++) {
        const double *z = y + c;
        for (int64_t i = 1; i + 1 < samples; i++) {
            double h = t[i] - t[i - 1], next = t[i + 1] - t[i];
            double chord = (z[i * channels] - z[(i - 1) * channels]) / h;
            double next_chord = (z[(i + 1) * channels] - z[i * channels]) / next;
            slope[i] = (chord * next + next_chord * h) / (next + h);
        }
        slope[0] = (z[channels] - z[0]) / (t[1] - t[0]);
        slope[samples - 1] = (z[(samples - 1) * channels] - z[(samples - 2) * channels]) /
                             (t[samples - 1] - t[samples - 2]);
        area[0] = 0.0;
        for (int64_t i = 0; i + 1 < samples; i++) {
            double h = t[i + 1] - t[i];
            area[i + 1] = area[i] + (h * (z[i * channels] + z[(i + 1) * channels]) / 2.0 +
                                     squared(h) * (slope[i] - slope[i + 1]) / 12.0);
        }
        double lag = cutoff_hz[c] > 0.0 ? 1.0 / (2.0 * PI * cutoff_hz[c]) : 0.0, before = 0.0;
        for (int64_t k = 0; k <= epochs; k++) {
            int64_t i = at[k];
            double step = t[i + 1] - t[i], s = (edges[k] - t[i]) / step;
            double y0 = z[i * channels], y1 = z[(i + 1) * channels], d0 = slope[i] * step, d1 = slope[i + 1] * step;
            double c2 = 3.0 * (y1 - y0) - 2.0 * d0 - d1, c3 = 2.0 * (y0 - y1) + d0 + d1;
            double integral = area[i] + step * s * (y0 + s * (d0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)));
            if (cutoff_hz[c] > 0.0) {
                double level = y0 + s * (d0 + s * (c2 + s * c3)), rate = (d0 + s * (2.0 * c2 + 3.0 * s * c3)) / step;
                integral = integral + sqrt(2.0) * lag * level + squared(lag) * rate;
            }
            if (k)
                mean[(k - 1) * channels + c] = (integral - before) / width;
            before = integral;
        }
    }
    free(slope);
    return 0;
}

/* Longest gap in and around each epoch, s; infinite without samples on both sides. */
static void widest_gaps(const double *t, int64_t samples, const double *edges, int64_t epochs, double *widest)
{
    int64_t after = 0;
    for (int64_t k = 0; k < epochs; k++) {
        widest[k] = INFINITY;
        while (after < samples && t[after] <= edges[k])
            after++;
        int64_t until = after;
        while (until < samples && t[until] < edges[k + 1])
            until++;
        if (after == 0 || until == samples)
            continue;
        widest[k] = t[after] - t[after - 1];
        for (int64_t i = after; i < until; i++)
            widest[k] = most(widest[k], t[i + 1] - t[i]);
    }
}

static void clear(const averages *out, int64_t n)
{
    memset(out->mean, 0, (size_t)(n * CHANNELS) * sizeof(double));
    memset(out->moment, 0, (size_t)n * sizeof(double));
    memset(out->aliasing_noise, 0, (size_t)n * sizeof(double));
    memset(out->covered, 0, (size_t)n);
    memset(out->resolved, 0, (size_t)n);
}

/* Means, moments and aliasing noise of samples of a source that filters nothing. */
static int64_t average_plain(const double *t, const double *y, int64_t samples, const double *edges, int64_t n,
                             double period_s, double limit_s, averages *out)
{
    int64_t *lost = malloc((size_t)samples * sizeof *lost);
    if (!lost)
        return NO_MEMORY;
    int64_t all = samples + count_lost(t, samples, period_s, limit_s, lost), status = 0;
    double *filled = NULL;
    const double *t_full = t, *y_full = y;
    if (all > samples) {
        filled = malloc((size_t)(all * (1 + CHANNELS)) * sizeof *filled);
        if (!filled) {
            free(lost);
            return NO_MEMORY;
        }
        fill_gaps(t, y, samples, CHANNELS, lost, filled, filled + all);
        t_full = filled;
        y_full = filled + all;
    }
    status = average_integrals(t_full, y_full, all, CHANNELS, edges, n, out->mean, out->moment);
    edge_aliasing(t_full, all, edges, n, out->aliasing_noise);
    add_gap_aliasing(t, samples, edges, n, period_s, out->aliasing_noise);
    free(filled);
    free(lost);
    return status;
}

int64_t average_stream(const stream *samples, const int64_t *edges_ns, int64_t n, averages *out)
{
    int64_t low = most_of(stamps_before(samples->t_ns, samples->length, edges_ns[0]) - 4, 0);
    int64_t high = least_of(stamps_before(samples->t_ns, samples->length, edges_ns[n]) + 4, samples->length);
    int64_t count = high - low, status = 0;
    const double *y = samples->values + low * CHANNELS;
    clear(out, n);
    if (count < 4)
        return 0;
    double *t = malloc((size_t)(count + n + 1 + n) * sizeof *t);
    if (!t)
        return NO_MEMORY;
    double *edges = t + count, *widest = edges + n + 1, period_s = 1.0 / samples->rate_hz;
    double limit_s = most(GAP_PERIODS / samples->rate_hz, MIN_GAP_S);
    for (int64_t i = 0; i < count; i++)
        t[i] = (double)(samples->t_ns[low + i] - edges_ns[0]) * 1e-9;
    for (int64_t k = 0; k <= n; k++)
        edges[k] = (double)(edges_ns[k] - edges_ns[0]) * 1e-9;
    if (samples->filtered)
        status = average_deconvolved(t, y, count, CHANNELS, edges, n, samples->cutoff_hz, out->mean);
    else
        status = average_plain(t, y, count, edges, n, period_s, limit_s, out);
    widest_gaps(t, count, edges, n, widest);
    bool moments = !samples->filtered && (edges[1] - edges[0]) * samples->rate_hz >= MOMENT_SAMPLES;
    for (int64_t k = 0; k < n; k++) {
        out->covered[k] = widest[k] <= limit_s;
        out->resolved[k] = moments && widest[k] <= MOMENT_GAP_PERIODS / samples->rate_hz;
        if (!out->covered[k]) {
            memset(out->mean + k * CHANNELS, 0, CHANNELS * sizeof(double));
            out->moment[k] = 0.0;
        }
    }
    free(t);
    return status;
}

int64_t read_stream(const stream_record *record, stream *out)
{
    bool good = true;
    *out = (stream){integers(record->t_ns, 1, &good), reals(record->values, 2, &good),
                    reals(record->cutoff_hz, 1, &good), record->rate_hz, extent(record->t_ns, 0),
                    record->filtered != 0};
    bool fits = good && extent(record->values, 0) == out->length && extent(record->values, 1) == CHANNELS &&
                extent(record->cutoff_hz, 0) == CHANNELS;
    return fits ? 0 : BAD_ARRAY;
}

/* Averages of a stream over the epochs between consecutive edges. */
EXPORT int64_t stream_averages(const stream_record *samples, const array *edges_in, const averages_record *record)
{
    bool good = true;
    stream read;
    const int64_t *edges_ns = integers(edges_in, 1, &good);
    averages out = {reals(record->mean, 2, &good), reals(record->moment, 1, &good),
                    reals(record->aliasing_noise, 1, &good), truths(record->covered, 1, &good),
                    truths(record->resolved, 1, &good)};
    int64_t n = extent(edges_in, 0) - 1;
    if (read_stream(samples, &read) || !good || n < 1 || extent(record->mean, 0) < n || extent(record->moment, 0) < n)
        return BAD_ARRAY;
    return average_stream(&read, edges_ns, n, &out);
}

/* As the function of this name, for samples of any number of channels. */
EXPORT int64_t stream_average_integrals(const array *t, const array *y, const array *edges, const array *mean,
                                        const array *moment)
{
    bool good = true;
    const double *times = reals(t, 1, &good), *values = reals(y, 2, &good), *at = reals(edges, 1, &good);
    double *means = reals(mean, 2, &good), *moments = reals(moment, 1, &good);
    int64_t samples = extent(t, 0), epochs = extent(edges, 0) - 1;
    if (!good || samples < 3)
        return BAD_ARRAY;
    return average_integrals(times, values, samples, extent(y, 1), at, epochs, means, moments);
}

/* As the function of this name. */
EXPORT int64_t stream_average_deconvolved(const array *t, const array *y, const array *edges, const array *cutoff_hz,
                                          const array *mean)
{
    bool good = true;
    const double *times = reals(t, 1, &good), *values = reals(y, 2, &good), *at = reals(edges, 1, &good);
    const double *cutoff = reals(cutoff_hz, 1, &good);
    double *means = reals(mean, 2, &good);
    int64_t samples = extent(t, 0), epochs = extent(edges, 0) - 1;
    if (!good || samples < 3)
        return BAD_ARRAY;
    return average_deconvolved(times, values, samples, extent(y, 1), at, epochs, cutoff, means);
}

/* Samples with cubics in their gaps; how many they are. They are written where there is room for them. */
EXPORT int64_t stream_fill_gaps(const array *t, const array *y, double period_s, double limit_s, const array *t_out,
                                const array *y_out)
{
    bool good = true;
    const double *times = reals(t, 1, &good), *values = reals(y, 2, &good);
    double *full_times = reals(t_out, 1, &good), *full_values = reals(y_out, 2, &good);
    int64_t samples = extent(t, 0);
    if (!good || samples < 4)
        return BAD_ARRAY;
    int64_t *lost = malloc((size_t)samples * sizeof *lost);
    if (!lost)
        return NO_MEMORY;
    int64_t all = samples + count_lost(times, samples, period_s, limit_s, lost);
    if (all <= extent(t_out, 0))
        fill_gaps(times, values, samples, extent(y, 1), lost, full_times, full_values);
    free(lost);
    return all;
}

/* Aliasing noise of each epoch by edges that cut samples, and by lost samples. */
EXPORT int64_t stream_aliasing(const array *t, const array *edges, double period_s, const array *by_edges,
                               const array *by_gaps)
{
    bool good = true;
    const double *times = reals(t, 1, &good), *at = reals(edges, 1, &good);
    double *cut = reals(by_edges, 1, &good), *gaps = reals(by_gaps, 1, &good);
    int64_t samples = extent(t, 0), epochs = extent(edges, 0) - 1;
    if (!good || samples < 3)
        return BAD_ARRAY;
    edge_aliasing(times, samples, at, epochs, cut);
    memset(gaps, 0, (size_t)epochs * sizeof *gaps);
    add_gap_aliasing(times, samples, at, epochs, period_s, gaps);
    return 0;
}

/* Put late stamps back: a sample close ahead of the next, and far behind the one before it, was held up at its sender,
 * and belongs in the middle of the gap. */
static void respace(const int64_t *t_ns, int64_t n, int64_t period_ns, int64_t *out)
{
    memcpy(out, t_ns, (size_t)n * sizeof *out);
    for (int64_t k = 1; k + 1 < n; k++) {
        bool close = (double)(t_ns[k + 1] - t_ns[k]) < LATE_AFTER_PERIODS * (double)period_ns;
        if (close && (double)(t_ns[k] - t_ns[k - 1]) > LATE_BEFORE_PERIODS * (double)period_ns) {
            int64_t sum = t_ns[k - 1] + t_ns[k + 1];
            out[k] = sum / 2 - (sum % 2 < 0);
        }
    }
}

/* Samples from `first` on and `more` behind them, respaced; whether they are in order of time (if not, as they are). */
EXPORT int64_t stream_append(const array *t_in, const array *values_in, int64_t first, const array *more_t_in,
                             const array *more_in, int64_t period_ns, const array *t_out, const array *values_out)
{
    bool good = true, ordered = true;
    const int64_t *t_ns = integers(t_in, 1, &good), *more_ns = integers(more_t_in, 1, &good);
    const double *values = reals(values_in, 2, &good), *more = reals(more_in, 2, &good);
    int64_t *all_ns = integers(t_out, 1, &good);
    double *all = reals(values_out, 2, &good);
    int64_t kept = extent(t_in, 0) - first, added = extent(more_t_in, 0), n = kept + added;
    int64_t width = extent(values_in, 1);
    if (!good || first < 0 || kept < 0 || extent(values_in, 0) != extent(t_in, 0) || extent(more_in, 0) != added ||
        extent(more_in, 1) != width || extent(t_out, 0) < n || extent(values_out, 0) < n ||
        extent(values_out, 1) != width)
        return BAD_ARRAY;
    memcpy(all, values + first * width, (size_t)(kept * width) * sizeof *all);
    memcpy(all + kept * width, more, (size_t)(added * width) * sizeof *all);
    int64_t *together = malloc((size_t)(n + 1) * sizeof *together);
    if (!together)
        return NO_MEMORY;
    memcpy(together, t_ns + first, (size_t)kept * sizeof *together);
    memcpy(together + kept, more_ns, (size_t)added * sizeof *together);
    for (int64_t k = 1; k < n; k++)
        ordered = ordered && together[k] > together[k - 1];
    if (ordered)
        respace(together, n, period_ns, all_ns);
    else
        memcpy(all_ns, together, (size_t)n * sizeof *together);
    free(together);
    return ordered;
}

/* Whether every sample is new, finite and inside the sensor's ranges of specific force and rate. */
EXPORT int64_t stream_all_valid(const array *t_in, const array *values_in, double accel_range, double gyro_range,
                                int64_t oldest_ns)
{
    bool good = true;
    const int64_t *t_ns = integers(t_in, 1, &good);
    const double *values = reals(values_in, 2, &good), ranges[2] = {accel_range, gyro_range};
    int64_t n = extent(t_in, 0);
    if (!good || extent(values_in, 0) != n || extent(values_in, 1) != 6)
        return BAD_ARRAY;
    bool valid = true;
    for (int64_t k = 0; k < n; k++) {
        valid = valid && t_ns[k] > oldest_ns;
        for (int64_t c = 0; c < 6; c++) /* false where it is not a number */
            valid = valid && fabs(values[k * 6 + c]) / ranges[c / 3] <= 1.0 - SATURATION_MARGIN;
    }
    return valid;
}
