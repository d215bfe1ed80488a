/* Measurement rows from averaged streams, without the motion of the rigid aircraft, and their Jacobian with respect
 * to the sensors' errors: see core/tracking/rigid_body.py and error_jacobians.py for the equations. */
#include "epochs.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "linear.h"
#include "streams.h"

#define GRAVITY_MPS2 9.80665
#define MIN_FORCE_MPS2 1.0          /* chosen: in free fall the lateral axis does not see the slope */
#define ROOT_MOMENT_SIGMAS 5.0      /* chosen: of the root's own first moment */
#define TILT_FOR_LATERAL_ERROR 0.05 /* chosen, rad: tip slope by which a lateral error enters a vertical row */

enum { LATERAL = 1, ROLL = 3 };                              /* channels */
enum { KZ, KY, KP, MX, MY, MZ, TAU, HEIGHT, BP, BR, ERRORS }; /* in the order of sensor_errors.py */
enum { SLOTS = 6 + 6 + 2 * (6 + 6 + 3 + 3) + 3 };   /* doubles per epoch in a motion */

/* Density of the root's accelerometer, and usual change by smoothing: vertical, lateral force, roll rate. */
typedef struct {
    double mps2_rthz;
    const array *usual_sigma;
} noise_record;

typedef struct {
    int64_t n, earlier, averaged;
    double step_s;
    const uint8_t *sends, *root_present; /* (3, 6) axes of each station */
    const double *levers;                /* (2, 3) from root to tips */
    double *smooth, *d_smooth;           /* (n, 6) root's force and rate, and their derivatives */
    double *tip[2], *d_tip[2];           /* (n, 6) as sensed; an axis that is not sent: as the rigid wing's */
    double *rigid[2], *d_rigid[2];       /* (n, 3) force of the rest wing, without the lift of the roll acceleration */
    double *beyond;                      /* (n, 3) */
    uint8_t *steady;                     /* (n,) the root moves as its means say */
} motion;

static void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static double sign_of(double a) { return (a > 0.0) - (a < 0.0); }

/* Central difference of (n, width); zero at the ends of the run and beside absent epochs. */
static void differentiate(const double *values, int64_t n, int64_t width, double step_s, const uint8_t *present,
                          double *out)
{
    memset(out, 0, (size_t)(n * width) * sizeof *out);
    for (int64_t k = 1; k + 1 < n; k++)
        if (present[k - 1] && present[k + 1])
            for (int64_t c = 0; c < width; c++)
                out[k * width + c] = (values[(k + 1) * width + c] - values[(k - 1) * width + c]) / (2.0 * step_s);
}

/* Weights 1/4, 1/2, 1/4 over neighbouring epochs of (n, 6). */
static void smoothe(const double *values, int64_t n, const uint8_t *present, double *out)
{
    memcpy(out, values, (size_t)(n * CHANNELS) * sizeof *out);
    for (int64_t k = 1; k + 1 < n; k++)
        if (present[k - 1] && present[k] && present[k + 1])
            for (int64_t c = k * CHANNELS; c < (k + 1) * CHANNELS; c++)
                out[c] = 0.25 * (values[c - CHANNELS] + values[c + CHANNELS]) + 0.5 * values[c];
}

/* Variances (n, 3) by motion that the filtered root does not resolve, where smoothing removes more than usual. */
static void root_motion_variance(const double *root, const motion *m, const double *usual_sigma, double *out)
{
    double lever = 0.0, *removed = m->beyond;
    for (int i = 0; i < 6; i++)
        lever = most(lever, fabs(m->levers[i]));
    for (int64_t k = 0; k < m->n; k++) {
        double change[CHANNELS], rate_change = 0.0, rate_norm = 0.0;
        for (int c = 0; c < CHANNELS; c++) {
            double smooth = m->smooth[k * CHANNELS + c];
            change[c] = fabs(root[k * CHANNELS + c] - smooth);
            rate_change += c >= ROLL ? squared(change[c]) : 0.0;
            rate_norm += c >= ROLL ? squared(smooth) : 0.0;
        }
        rate_change = sqrt(rate_change);
        double centripetal = lever * rate_change * (2.0 * sqrt(rate_norm) + rate_change);
        bool beyond = rate_change > usual_sigma[2] || change[LATERAL] > usual_sigma[1];
        double *here = removed + 3 * k;
        here[2] = change[ROLL] > usual_sigma[2] ? change[ROLL] : 0.0;
        here[1] = beyond ? change[LATERAL] + centripetal : 0.0;
        here[0] = (change[VERTICAL] > usual_sigma[0] ? change[VERTICAL] : 0.0) + TILT_FOR_LATERAL_ERROR * here[1];
    }
    for (int64_t k = 0; k < m->n; k++)
        for (int c = 0; c < 3; c++) {
            double largest = 0.0;
            for (int64_t near = most_of(k - 1, 0); near <= least_of(k + 1, m->n - 1); near++)
                largest = most(largest, removed[3 * near + c]);
            out[3 * k + c] = squared(largest);
        }
}

/* Epochs in which the root moves as its means say: a shaken support moves otherwise inside an epoch, and so does the
 * wing on it, and a first moment is no bending then. */
static void find_steady(const averages *root, double mps2_rthz, motion *m)
{
    double limit = ROOT_MOMENT_SIGMAS * mps2_rthz / sqrt(24.0 * m->step_s);
    for (int64_t k = 0; k < m->n; k++) {
        double slope = 0.0;
        if (k > 0 && k + 1 < m->n && root->covered[k - 1] && root->covered[k + 1])
            slope = (root->mean[(k + 1) * CHANNELS + VERTICAL] - root->mean[(k - 1) * CHANNELS + VERTICAL]) /
                    (2.0 * m->step_s);
        m->steady[k] = !root->resolved[k] || fabs(root->moment[k] - m->step_s / 12.0 * slope) < limit;
    }
}

/* Rigid motion at the tips and what they sensed, with derivatives. */
static void find_motion(const averages *station, bool filtered, motion *m)
{
    int64_t n = m->n;
    m->root_present = station[0].covered;
    if (filtered)
        smoothe(station[0].mean, n, m->root_present, m->smooth);
    else
        memcpy(m->smooth, station[0].mean, (size_t)(n * CHANNELS) * sizeof(double));
    differentiate(m->smooth, n, CHANNELS, m->step_s, m->root_present, m->d_smooth);
    for (int side = 0; side < 2; side++) {
        const double *arm = m->levers + 3 * side;
        for (int64_t k = 0; k < n; k++) {
            const double *force = m->smooth + k * CHANNELS, *rate = force + ROLL;
            const double *rate_dot = m->d_smooth + k * CHANNELS + ROLL;
            double tangential[3], inner[3], centripetal[3], *rigid = m->rigid[side] + 3 * k;
            cross(rate_dot, arm, tangential);
            cross(rate, arm, inner);
            cross(rate, inner, centripetal);
            for (int axis = 0; axis < 3; axis++)
                rigid[axis] = force[axis] + tangential[axis] + centripetal[axis];
            rigid[2] -= rate_dot[0] * arm[1]; /* the filter's business */
        }
        differentiate(m->rigid[side], n, 3, m->step_s, m->root_present, m->d_rigid[side]);
        const averages *tip = station + 1 + side;
        differentiate(tip->mean, n, CHANNELS, m->step_s, tip->covered, m->d_tip[side]);
        for (int64_t k = 0; k < n; k++)
            for (int c = 0; c < CHANNELS; c++) {
                double unsent = c < ROLL ? m->rigid[side][3 * k + c] : m->smooth[k * CHANNELS + c];
                bool sent = m->sends[(1 + side) * CHANNELS + c];
                m->tip[side][k * CHANNELS + c] = sent ? tip->mean[k * CHANNELS + c] : unsent;
            }
    }
}

/* Rows that were measured in epoch k. */
static void find_present(const averages *station, const motion *m, int64_t k, uint8_t *present)
{
    bool root = station[0].covered[k];
    present[P_ROOT] = root && m->sends[ROLL];
    for (int side = 0; side < 2; side++) {
        const uint8_t *sends = m->sends + (1 + side) * CHANNELS;
        bool tip = station[1 + side].covered[k];
        present[Z_LEFT + side] = tip && root && sends[VERTICAL];
        present[Y_LEFT + side] = present[Z_LEFT + side] && sends[LATERAL]; /* it is divided by the vertical force */
        present[M_LEFT + side] = present[Z_LEFT + side] && m->steady[k] && station[1 + side].resolved[k];
        present[P_LEFT + side] = tip && sends[ROLL];
    }
}

/* Inverse vertical specific force, signed for the side; removes the slope row in free fall. */
static double lateral_gain(const motion *m, int64_t k, int side, uint8_t *present)
{
    double force = m->tip[side][k * CHANNELS + 2];
    if (fabs(force) < MIN_FORCE_MPS2) {
        present[Y_LEFT + side] = false;
        force = -GRAVITY_MPS2;
    }
    return (1.0 - 2.0 * side) / force;
}

typedef struct {
    double *out; /* (ROWS, parameters) of one epoch */
    const uint8_t *present;
    int64_t parameters;
} jacobian;

/* Set one sensitivity, if the row was measured and the parameter exists. */
static void set(const jacobian *j, int row, int64_t column, double value)
{
    if (column >= 0 && j->present[row])
        j->out[row * j->parameters + column] = value;
}

/* Mean (width,) of values (n, width) over the epochs from `earlier + averaged - 1` to `earlier` before epoch k in which
 * the root was present; those of epoch k where it was in none. */
static void mean_before(const double *values, int64_t width, const motion *m, int64_t k, double *out)
{
    int64_t last = k - m->earlier, first = most_of(last - m->averaged + 1, 0), count = 0;
    memset(out, 0, (size_t)width * sizeof *out);
    for (int64_t at = first; at <= last; at++)
        if (m->root_present[at]) {
            add_scaled(out, values + at * width, 1.0, width);
            count++;
        }
    for (int64_t c = 0; c < width; c++)
        out[c] = count ? out[c] / (double)count : values[k * width + c];
}

/* Columns of a tip's scale, misalignment and stamp errors. The rigid part of what is scaled is `before`, the mean of
 * some epochs: the filter takes the row's innovation, tip less rigid motion, out of the regressor, and so the root's
 * noise, which must then be in the regressor too. What a misalignment mixes in from other axes is the rigid motion, as
 * the root had it in the mean of those epochs: the tip's own axes carry vibration that is coherent with the row's. */
static void tip_errors(const jacobian *j, const motion *m, int64_t k, int side, const double *before,
                       const double *root_before, double roll_accel, double moment, double gain,
                       const int64_t *columns)
{
    const double *tip = m->tip[side] + k * CHANNELS, *rate = m->d_tip[side] + k * CHANNELS;
    const double *now = m->rigid[side] + 3 * k, *turn = root_before + ROLL;
    double y = tip[1], z = tip[2], scaled_y = y + before[1] - now[1], scaled_z = z + before[2] - now[2];
    double scaled_p = tip[3] + turn[0] - m->smooth[k * CHANNELS + ROLL];
    int vertical = Z_LEFT + side, lateral = Y_LEFT + side, roll = P_LEFT + side;
    set(j, vertical, columns[KZ], scaled_z);
    set(j, M_LEFT + side, columns[KZ], moment);
    set(j, lateral, columns[KZ], -(y - now[1]) * gain);
    set(j, lateral, columns[KY], scaled_y * gain);
    set(j, roll, columns[KP], scaled_p);
    set(j, vertical, columns[MX], -before[1]);
    set(j, lateral, columns[MX], z * gain);
    set(j, vertical, columns[MY], before[0]);
    set(j, roll, columns[MY], -turn[2]);
    set(j, lateral, columns[MZ], -before[0] * gain);
    set(j, roll, columns[MZ], turn[1]);
    set(j, vertical, columns[HEIGHT], squared(turn[0]) + squared(turn[1]));
    set(j, lateral, columns[HEIGHT], (roll_accel - turn[1] * turn[2]) * gain);
    set(j, vertical, columns[TAU], -rate[2]);
    set(j, lateral, columns[TAU], -(rate[1] - (y - now[1]) * rate[2] * fabs(gain) * sign_of(z)) * gain);
    set(j, roll, columns[TAU], -rate[3]);
}

/* Columns of the root's errors in one tip's rows; its force is that of one epoch earlier, so that its noise is
 * uncorrelated with the innovations that it multiplies. */
static void root_errors(const jacobian *j, const motion *m, int64_t k, int side, double gain, const int64_t *columns)
{
    const double *force = m->smooth + most_of(k - 1, 0) * CHANNELS, *rate = m->smooth + k * CHANNELS + ROLL;
    const double *d_force = m->d_smooth + k * CHANNELS, *arm = m->levers + 3 * side;
    double x = force[0], y = force[1], z = force[2], p = rate[0], q = rate[1], r = rate[2];
    int vertical = Z_LEFT + side, lateral = Y_LEFT + side;
    set(j, vertical, columns[KZ], -z);
    set(j, lateral, columns[KY], -y * gain);
    set(j, lateral, columns[KP], 2.0 * arm[1] * squared(p) * gain);
    set(j, vertical, columns[MX], y);
    set(j, lateral, columns[MX], -z * gain);
    set(j, vertical, columns[MY], -x);
    set(j, lateral, columns[MZ], x * gain);
    set(j, vertical, columns[HEIGHT], -squared(p) - squared(q));
    set(j, lateral, columns[HEIGHT], (q * r - m->d_smooth[k * CHANNELS + ROLL]) * gain);
    set(j, vertical, columns[TAU], d_force[2]);
    set(j, lateral, columns[TAU], d_force[1] * gain);
    set(j, vertical, columns[BP], 2.0 * arm[2] * p - arm[0] * r);
    set(j, lateral, columns[BP], (2.0 * arm[1] * p - arm[0] * q) * gain);
    set(j, vertical, columns[BR], -(arm[0] * p + arm[1] * q));
    set(j, lateral, columns[BR], (2.0 * arm[1] * r - arm[2] * q) * gain);
}

/* Columns of the root's errors in its roll-rate row. */
static void roll_errors(const jacobian *j, const motion *m, int64_t k, const int64_t *columns)
{
    const double *rate = m->smooth + k * CHANNELS + ROLL;
    set(j, P_ROOT, columns[KP], rate[0]);
    set(j, P_ROOT, columns[MY], -rate[2]);
    set(j, P_ROOT, columns[MZ], rate[1]);
    set(j, P_ROOT, columns[TAU], -m->d_smooth[k * CHANNELS + ROLL]);
}

typedef struct {
    double *rows, *vertical, *lateral, *slope_rate_gain, *gain, *load_g, *body_rate, *earlier_roll, *earlier_load,
        *sensitivity, *aliasing, *motion;
    uint8_t *present, *covered;
    int64_t *start_ns, parameters;
} epoch_columns;

static bool read_columns(const epochs_record *record, int64_t n, epoch_columns *out)
{
    bool good = true;
    *out = (epoch_columns){
        .rows = reals(record->rows, 2, &good),
        .vertical = reals(record->vertical_mps2, 2, &good),
        .lateral = reals(record->lateral_mps2, 2, &good),
        .slope_rate_gain = reals(record->slope_rate_gain, 2, &good),
        .gain = reals(record->lateral_gain, 2, &good),
        .load_g = reals(record->load_g, 1, &good),
        .body_rate = reals(record->body_rate_radps, 2, &good),
        .earlier_roll = reals(record->earlier_roll_radps2, 1, &good),
        .earlier_load = reals(record->earlier_load_g, 1, &good),
        .sensitivity = reals(record->sensitivity, 3, &good),
        .aliasing = reals(record->aliasing_noise, 2, &good),
        .motion = reals(record->root_motion_variance, 2, &good),
        .present = truths(record->present, 2, &good),
        .covered = truths(record->root_covered, 1, &good),
        .start_ns = integers(record->start_ns, 1, &good),
        .parameters = extent(record->sensitivity, 2),
    };
    const array *all[] = {record->rows,         record->present, record->vertical_mps2,   record->lateral_mps2,
                          record->load_g,       record->start_ns, record->slope_rate_gain, record->lateral_gain,
                          record->sensitivity,  record->body_rate_radps, record->earlier_roll_radps2,
                          record->earlier_load_g, record->aliasing_noise, record->root_motion_variance,
                          record->root_covered};
    for (size_t k = 0; k < sizeof all / sizeof *all; k++)
        good = good && extent(all[k], 0) >= n;
    return good;
}

/* Rows of one tip in epoch k, and the terms of their linearisation. */
static void tip_rows(const averages *station, const motion *m, int64_t k, int side, const double *before,
                     const epoch_columns *out)
{
    const double *tip = m->tip[side] + k * CHANNELS, *rigid = m->rigid[side] + 3 * k;
    const uint8_t *present = out->present + k * ROWS;
    double *rows = out->rows + k * ROWS, moment = station[1 + side].moment[k], gain = out->gain[2 * k + side];
    rows[Z_LEFT + side] = tip[2] - rigid[2];
    rows[M_LEFT + side] = moment - m->step_s / 12.0 * m->d_rigid[side][3 * k + 2];
    rows[Y_LEFT + side] = atan((tip[1] - rigid[1]) * gain);
    rows[P_LEFT + side] = tip[3];
    out->vertical[2 * k + side] = present[Z_LEFT + side] ? tip[2] + before[2] - rigid[2] : 0.0;
    out->lateral[2 * k + side] = present[Z_LEFT + side] ? rigid[1] * (1.0 - 2.0 * side) : 0.0;
    out->slope_rate_gain[2 * k + side] =
        present[Y_LEFT + side] ? -moment * m->step_s * fabs(gain) * sign_of(tip[2]) : 0.0;
    out->aliasing[2 * k + side] = station[1 + side].aliasing_noise[k];
}

static void fill_epoch(const averages *station, const motion *m, int64_t k, const int64_t *columns,
                       const epoch_columns *out)
{
    uint8_t *present = out->present + k * ROWS;
    double *rows = out->rows + k * ROWS, *gain = out->gain + 2 * k;
    const double *rate = m->smooth + k * CHANNELS + ROLL;
    jacobian j = {out->sensitivity + k * ROWS * out->parameters, present, out->parameters};
    find_present(station, m, k, present);
    double earlier[CHANNELS], root_before[CHANNELS];
    mean_before(m->d_smooth, CHANNELS, m, k, earlier);
    mean_before(m->smooth, CHANNELS, m, k, root_before);
    out->earlier_roll[k] = earlier[ROLL];
    for (int side = 0; side < 2; side++) {
        double before[3]; /* the rigid force without this epoch's noise of the root, which is in the rows too */
        mean_before(m->rigid[side], 3, m, k, before);
        gain[side] = lateral_gain(m, k, side, present);
        tip_rows(station, m, k, side, before, out);
        tip_errors(&j, m, k, side, before, root_before, earlier[ROLL], station[1 + side].moment[k], gain[side],
                   columns + (1 + side) * ERRORS);
        root_errors(&j, m, k, side, gain[side], columns);
        if (!present[Y_LEFT + side])
            gain[side] = 0.0;
    }
    roll_errors(&j, m, k, columns);
    rows[P_ROOT] = rate[0];
    for (int row = 0; row < ROWS; row++)
        if (!present[row])
            rows[row] = 0.0;
    out->covered[k] = station[0].covered[k];
    bool loaded = m->sends[VERTICAL] && out->covered[k], goes_on = k + 1 < m->n && station[0].covered[k + 1];
    out->load_g[k] = loaded ? -m->smooth[k * CHANNELS + VERTICAL] / GRAVITY_MPS2 - 1.0 : 0.0;
    out->earlier_load[k] = loaded ? -root_before[VERTICAL] / GRAVITY_MPS2 - 1.0 : 0.0;
    for (int axis = 0; axis < 3; axis++)
        out->body_rate[3 * k + axis] = goes_on ? 0.5 * (rate[axis] + rate[CHANNELS + axis]) : rate[axis];
}

/* Room of a motion and three averages in one piece. */
static double *make_room(int64_t n, motion *m, averages *station)
{
    int64_t each = CHANNELS + 2, flags = 7 * n;
    double *room = malloc((size_t)(n * (SLOTS + 3 * each)) * sizeof *room + (size_t)flags), *next = room;
    if (!room)
        return NULL;
    m->smooth = next, next += 6 * n;
    m->d_smooth = next, next += 6 * n;
    for (int side = 0; side < 2; side++) {
        m->tip[side] = next, next += 6 * n;
        m->d_tip[side] = next, next += 6 * n;
        m->rigid[side] = next, next += 3 * n;
        m->d_rigid[side] = next, next += 3 * n;
    }
    m->beyond = next, next += 3 * n;
    for (int s = 0; s < 3; s++) {
        station[s].mean = next, next += 6 * n;
        station[s].moment = next, next += n;
        station[s].aliasing_noise = next, next += n;
    }
    uint8_t *flag = (uint8_t *)next;
    for (int s = 0; s < 3; s++) {
        station[s].covered = flag, flag += n;
        station[s].resolved = flag, flag += n;
    }
    m->steady = flag;
    return room;
}

/* Epochs between n + 1 edges from the streams of root, left and right tip. `columns` (3, ERRORS): of each error of each
 * sensor in the Jacobian, -1 where absent; the arrays of `record` have n epochs. */
EXPORT int64_t epochs_build(const stream_record *root, const stream_record *left, const stream_record *right,
                            const array *edges_in, const array *sends_in, const array *levers_in,
                            const noise_record *noise, const array *columns_in, int64_t earlier, int64_t averaged,
                            const epochs_record *record)
{
    bool good = true;
    stream streams[3];
    const stream_record *records[3] = {root, left, right};
    const int64_t *edges_ns = integers(edges_in, 1, &good), *columns = integers(columns_in, 2, &good);
    int64_t n = extent(edges_in, 0) - 1, status = 0;
    motion m = {.n = n, .earlier = earlier, .averaged = averaged};
    averages station[3];
    epoch_columns out;
    m.sends = truths(sends_in, 2, &good);
    m.levers = reals(levers_in, 2, &good);
    const double *usual_sigma = reals(noise->usual_sigma, 1, &good);
    for (int s = 0; s < 3; s++)
        good = good && read_stream(records[s], &streams[s]) == 0;
    if (!good || n < 1 || !read_columns(record, n, &out))
        return BAD_ARRAY;
    if (extent(columns_in, 0) != 3 || extent(columns_in, 1) != ERRORS || /* an error that the enum does not have */
        !all_within(columns, 3 * ERRORS, -1, out.parameters))
        return BAD_ARRAY;
    double *room = make_room(n, &m, station);
    if (!room)
        return NO_MEMORY;
    m.step_s = (double)(edges_ns[1] - edges_ns[0]) * 1e-9;
    for (int s = 0; s < 3 && !status; s++)
        status = average_stream(&streams[s], edges_ns, n, &station[s]);
    if (!status) {
        find_motion(station, streams[0].filtered, &m);
        find_steady(&station[0], noise->mps2_rthz, &m);
        memset(out.motion, 0, (size_t)(3 * n) * sizeof(double));
        if (streams[0].filtered)
            root_motion_variance(station[0].mean, &m, usual_sigma, out.motion);
        memset(out.sensitivity, 0, (size_t)(n * ROWS * out.parameters) * sizeof(double));
        memcpy(out.start_ns, edges_ns, (size_t)n * sizeof *edges_ns);
        for (int64_t k = 0; k < n; k++)
            fill_epoch(station, &m, k, columns, &out);
    }
    free(room);
    return status;
}
