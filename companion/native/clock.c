/* Clocks: stamps by a map's knots (core/clock/clock_map.py), and the set of feasible lines (core/clock/sync_set.py). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "arrays.h"

/* Largest error of a stamp at `host_ns` by a knot's (shrink, bound, rate of the bound). */
static int64_t bound_at_ns(const double *slope, int64_t from_ns, int64_t host_ns)
{
    return (int64_t)(slope[1] + slope[2] * (double)llabs(host_ns - from_ns)) + 1;
}

/* Place of the knot whose segment holds a stamp; the first one's where none does. `guess` is that of the stamp before.
 */
static int64_t knot_of(const int64_t *stamps, int64_t count, int64_t t_ns, int64_t guess)
{
    while (guess + 1 < count && stamps[2 * (guess + 1)] <= t_ns)
        guess++;
    while (guess > 0 && stamps[2 * guess] > t_ns)
        guess--;
    return guess;
}

/* Stamps (n,) to host time by the first `count` knots: (remote, host) and (shrink, bound, rate of the bound) of each.
 * `ends`: oldest and newest host stamp, largest bound. */
EXPORT int64_t clock_to_host(const array *t_ns_in, const array *stamps_in, const array *slopes_in, int64_t count,
                             const array *host_out, const array *ends_out)
{
    bool good = true;
    const int64_t *t_ns = integers(t_ns_in, 1, &good), *stamps = integers(stamps_in, 2, &good);
    const double *slopes = reals(slopes_in, 2, &good);
    int64_t *host = integers(host_out, 1, &good), *ends = integers(ends_out, 1, &good), n = extent(t_ns_in, 0);
    if (!good || n < 1 || count < 1 || count > extent(stamps_in, 0) || count > extent(slopes_in, 0) ||
        extent(host_out, 0) < n || extent(ends_out, 0) < 3)
        return BAD_ARRAY;
    int64_t at = count - 1, first = count - 1, last = 0, oldest = 0, newest = 0;
    for (int64_t k = 0; k < n; k++) {
        at = knot_of(stamps, count, t_ns[k], at);
        int64_t elapsed = t_ns[k] - stamps[2 * at];
        host[k] = stamps[2 * at + 1] + elapsed - (int64_t)(slopes[3 * at] * (double)elapsed);
        first = least_of(first, at);
        last = most_of(last, at);
        oldest = t_ns[k] < t_ns[oldest] ? k : oldest;
        newest = t_ns[k] > t_ns[newest] ? k : newest;
    }
    int64_t bound = most_of(bound_at_ns(slopes + 3 * first, stamps[2 * first + 1], host[oldest]),
                            bound_at_ns(slopes + 3 * last, stamps[2 * last + 1], host[newest]));
    for (int64_t k = first; k < last; k++)
        bound = most_of(bound, bound_at_ns(slopes + 3 * k, stamps[2 * k + 1], stamps[2 * k + 3]));
    ends[0] = host[oldest];
    ends[1] = host[newest];
    ends[2] = bound;
    return 0;
}

typedef struct {
    double offset, skew;
} corner;

/* Cut a polygon by one bound, an upper one with `sign` 1, a lower with -1 (Sutherland and Hodgman 1974); how many
 * corners are left. `out` has room for twice as many. */
static int64_t cut_once(const corner *in, int64_t count, double at, double value, double sign, corner *out)
{
    int64_t left = 0;
    for (int64_t i = 0; i < count; i++) {
        const corner *before = &in[i ? i - 1 : count - 1], *here = &in[i];
        double excess_before = sign * (before->offset + before->skew * at - value);
        double excess = sign * (here->offset + here->skew * at - value);
        if ((excess <= 0.0) != (excess_before <= 0.0)) {
            double fraction = excess_before / (excess_before - excess);
            out[left].offset = before->offset + fraction * (here->offset - before->offset);
            out[left++].skew = before->skew + fraction * (here->skew - before->skew);
        }
        if (excess <= 0.0)
            out[left++] = *here;
    }
    return left;
}

/* Move the polygon of `corners` (k, 2) to a reference time that is later, and cut it by every bound (time, value) of
 * `uppers` and `lowers`, (n, 2) each; how many corners are left. They are written where `corners_out` has room. */
EXPORT int64_t clock_cut(const array *corners_in, double later_ns, const array *uppers_in, const array *lowers_in,
                         const array *corners_out)
{
    bool good = true;
    const double *corners = reals(corners_in, 2, &good);
    const double *bounds[2] = {reals(uppers_in, 2, &good), reals(lowers_in, 2, &good)};
    double *out = reals(corners_out, 2, &good);
    if (!good)
        return BAD_ARRAY;
    int64_t count = extent(corners_in, 0), lengths[2] = {extent(uppers_in, 0), extent(lowers_in, 0)};
    corner *polygon = malloc((size_t)(count + 1) * sizeof *polygon);
    if (!polygon)
        return NO_MEMORY;
    memcpy(polygon, corners, (size_t)count * sizeof *polygon);
    for (int64_t k = 0; k < count; k++)
        polygon[k].offset += polygon[k].skew * later_ns;
    for (int kind = 0; kind < 2; kind++)
        for (int64_t k = 0; k < lengths[kind]; k++) {
            corner *cut = malloc((size_t)(2 * count + 1) * sizeof *cut);
            if (!cut) {
                free(polygon);
                return NO_MEMORY;
            }
            count = cut_once(polygon, count, bounds[kind][2 * k], bounds[kind][2 * k + 1], kind ? -1.0 : 1.0, cut);
            free(polygon);
            polygon = cut;
        }
    if (count && count <= extent(corners_out, 0))
        memcpy(out, polygon, (size_t)count * sizeof *polygon);
    free(polygon);
    return count;
}

/* Offset, skew and the half-widths of both of a polygon (k, 2): the mean of its two extreme lines. */
EXPORT int64_t clock_centre(const array *corners_in, const array *centre_out)
{
    bool good = true;
    const corner *corners = (const corner *)reals(corners_in, 2, &good);
    double *centre = reals(centre_out, 1, &good), half_skew = 0.0;
    int64_t count = extent(corners_in, 0);
    if (!good || count < 1 || extent(centre_out, 0) < 4)
        return BAD_ARRAY;
    corner low = corners[0], high = corners[0];
    for (int64_t k = 1; k < count; k++) {
        corner here = corners[k];
        if (here.offset < low.offset || (here.offset == low.offset && here.skew < low.skew))
            low = here;
        if (here.offset > high.offset || (here.offset == high.offset && here.skew > high.skew))
            high = here;
    }
    double skew = 0.5 * (low.skew + high.skew);
    for (int64_t k = 0; k < count; k++)
        half_skew = most(half_skew, fabs(corners[k].skew - skew));
    centre[0] = 0.5 * (low.offset + high.offset);
    centre[1] = skew;
    centre[2] = 0.5 * (high.offset - low.offset);
    centre[3] = half_skew;
    return 0;
}
