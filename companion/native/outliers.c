/* Outliers among the samples of a stream: see core/tracking/sample_outliers.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"

#define NEIGHBOURS 3             /* derived: two for the cubic, one more for the cubic of a neighbour */
#define NOISE_SIGMAS 8.0         /* chosen: of the sensor's noise; Gaussian noise exceeds it once in 1e15 */
#define MEDIAN_SIGMAS 12.0       /* chosen: a lateral axis shows slope times force, whose tails are long */
#define NEIGHBOUR_RATIO 0.3      /* chosen: residual of the neighbours over the sample's, once this is replaced */
#define SPAN_RATIO 0.5           /* chosen: residual over the span of the neighbours; a smaller one is motion */
#define MOST_TILT 0.2            /* chosen, rad: of a bent tip, whose lateral axis shows so much vertical force */
#define VERTICAL 2               /* channel (by definition) */
#define WINDOW 16                /* chosen: samples on either side for the median residual */
#define SIGMAS_PER_MEDIAN 1.4826 /* derived: standard deviation over the median magnitude of a Gaussian */
#define MIN_GAP_PERIODS 0.2      /* chosen: a cubic through samples closer or farther says nothing */
#define MAX_GAP_PERIODS 2.5      /* chosen: as before */

/* Residual of a sample from the cubic through its neighbours; 0 where they are too far or too close. */
static double residual_of(const int64_t *t_ns, const double *y, int64_t i, double period_ns)
{
    for (int64_t k = i - 2; k < i + 2; k++) {
        double gap = (double)(t_ns[k + 1] - t_ns[k]);
        if (!(MIN_GAP_PERIODS * period_ns < gap && gap < MAX_GAP_PERIODS * period_ns))
            return 0.0;
    }
    double a = (double)(t_ns[i - 2] - t_ns[i]), b = (double)(t_ns[i - 1] - t_ns[i]);
    double c = (double)(t_ns[i + 1] - t_ns[i]), d = (double)(t_ns[i + 2] - t_ns[i]);
    double first = y[i - 2] * (b * c * d) / ((b - a) * (c - a) * (d - a));
    double second = y[i - 1] * (a * c * d) / ((a - b) * (c - b) * (d - b));
    double third = y[i + 1] * (a * b * d) / ((a - c) * (b - c) * (d - c));
    double last = y[i + 2] * (a * b * c) / ((a - d) * (b - d) * (c - d));
    return y[i] - (first + second + third + last);
}

/* Whether the sample's vertical force, which a tilted sensor feels in this channel too, explains its residual. */
static bool explained(const int64_t *t_ns, const double *vertical, int64_t channel, int64_t i, double residual_here,
                      double period_ns)
{
    return channel < VERTICAL && residual_here < MOST_TILT * fabs(residual_of(t_ns, vertical, i, period_ns));
}

/* Whether a sample stands clear of the span of its neighbours, and these fit once it is replaced. */
static bool isolated(const int64_t *t_ns, double *y, int64_t i, double residual_here, double period_ns)
{
    double lowest = least(least(y[i - 2], y[i - 1]), least(y[i + 1], y[i + 2]));
    double highest = most(most(y[i - 2], y[i - 1]), most(y[i + 1], y[i + 2]));
    if (residual_here < SPAN_RATIO * (highest - lowest))
        return false;
    double original = y[i];
    y[i] -= residual_of(t_ns, y, i, period_ns);
    double before = fabs(residual_of(t_ns, y, i - 1, period_ns)), after = fabs(residual_of(t_ns, y, i + 1, period_ns));
    y[i] = original;
    return most(before, after) < NEIGHBOUR_RATIO * residual_here;
}

static int by_size(const void *a, const void *b)
{
    double one = *(const double *)a, other = *(const double *)b;
    return (one > other) - (one < other);
}

/* Median residual of the samples around one, without those that it affects itself. */
static double median_residual(const double *residual, int64_t count, int64_t i)
{
    double around[2 * WINDOW];
    int64_t length = 0;
    for (int64_t k = most_of(i - WINDOW, 2); k < i - 2; k++)
        around[length++] = residual[k];
    for (int64_t k = i + 3; k < least_of(count - 2, i + 3 + WINDOW - 2); k++)
        around[length++] = residual[k];
    if (!length)
        return 0.0;
    qsort(around, (size_t)length, sizeof *around, by_size);
    return 0.5 * (around[(length - 1) / 2] + around[length / 2]);
}

static void find_in_channel(const int64_t *t_ns, double *series, const double *vertical, int64_t channel,
                            int64_t count, int64_t first, double noise_sigma, double period_ns, double *residual,
                            uint8_t *out)
{
    double largest = 0.0;
    for (int64_t i = most_of(first - WINDOW, 2); i < count - 2; i++) {
        residual[i] = fabs(residual_of(t_ns, series, i, period_ns));
        if (i >= first)
            largest = most(largest, residual[i]);
    }
    if (largest <= NOISE_SIGMAS * noise_sigma)
        return;
    for (int64_t i = most_of(first, NEIGHBOURS); i < count - NEIGHBOURS; i++)
        if (residual[i] > NOISE_SIGMAS * noise_sigma && isolated(t_ns, series, i, residual[i], period_ns) &&
            !explained(t_ns, vertical, channel, i, residual[i], period_ns) &&
            residual[i] > MEDIAN_SIGMAS * SIGMAS_PER_MEDIAN * median_residual(residual, count, i))
            out[i] = 1;
}

/* Mark the outliers of a stream (s, channels) from sample `first` on; how many there are. */
EXPORT int64_t stream_outliers(const array *t_in, const array *values_in, int64_t first, const array *sigma_in,
                               double period_ns, const array *out_in)
{
    bool good = true;
    const int64_t *t_ns = integers(t_in, 1, &good);
    const double *values = reals(values_in, 2, &good), *noise_sigma = reals(sigma_in, 1, &good);
    uint8_t *out = truths(out_in, 1, &good);
    int64_t count = extent(t_in, 0), channels = extent(values_in, 1), found = 0;
    if (!good || extent(values_in, 0) != count || channels <= VERTICAL || extent(out_in, 0) < count ||
        extent(sigma_in, 0) < channels)
        return BAD_ARRAY;
    double *series = malloc((size_t)(3 * count + 1) * sizeof *series), *residual = series + count;
    double *vertical = residual + count;
    if (!series)
        return NO_MEMORY;
    memset(out, 0, (size_t)count);
    memset(residual, 0, (size_t)count * sizeof *residual);
    for (int64_t k = 0; k < count; k++)
        vertical[k] = values[k * channels + VERTICAL];
    for (int64_t channel = 0; channel < channels; channel++) {
        for (int64_t k = 0; k < count; k++)
            series[k] = values[k * channels + channel];
        find_in_channel(t_ns, series, vertical, channel, count, first, noise_sigma[channel], period_ns, residual, out);
    }
    for (int64_t k = 0; k < count; k++)
        found += out[k];
    free(series);
    return found;
}
