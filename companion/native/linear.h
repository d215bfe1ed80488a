/* Linear algebra of small matrices, row after row: a library's calls cost more than these loops. */
#ifndef SPANWISE_LINEAR_H
#define SPANWISE_LINEAR_H

#include <math.h>

#include "arrays.h"

/* Sum of products in four parts, so that the processor need not wait for each sum. */
static inline double dot(const double *a, const double *b, int64_t n)
{
    double parts[4] = {0.0, 0.0, 0.0, 0.0};
    int64_t k = 0;
    for (; k + 4 <= n; k += 4)
        for (int p = 0; p < 4; p++)
            parts[p] += a[k + p] * b[k + p];
    for (; k < n; k++)
        parts[0] += a[k] * b[k];
    return (parts[0] + parts[1]) + (parts[2] + parts[3]);
}

/* Add `factor` times a row to another. */
static inline void add_scaled(double *restrict to, const double *restrict row, double factor, int64_t n)
{
    for (int64_t k = 0; k < n; k++)
        to[k] += factor * row[k];
}

/* Add four rows by their factors to another, as by `add_scaled` one after the other, with one store of each sum. */
static inline void add_four(double *restrict to, int64_t n, const double *restrict a, const double *restrict b,
                            const double *restrict c, const double *restrict d, double by_a, double by_b, double by_c,
                            double by_d)
{
    for (int64_t j = 0; j < n; j++)
        to[j] = to[j] + by_a * a[j] + by_b * b[j] + by_c * c[j] + by_d * d[j];
}

/* Add two rows by their factors to another, likewise. */
static inline void add_two(double *restrict to, int64_t n, const double *restrict a, const double *restrict b,
                           double by_a, double by_b)
{
    for (int64_t j = 0; j < n; j++)
        to[j] = to[j] + by_a * a[j] + by_b * b[j];
}

/* Add the combination of `count` rows, `pitch` apart and of length n, to another one, by factors `stride` apart. */
static inline void add_combination(double *restrict to, int64_t n, const double *rows, int64_t pitch,
                                   const double *factors, int64_t stride, int64_t count)
{
    int64_t k = 0;
    for (; k + 4 <= count; k += 4) {
        const double *row = rows + k * pitch, *by = factors + k * stride;
        add_four(to, n, row, row + pitch, row + 2 * pitch, row + 3 * pitch, by[0], by[stride], by[2 * stride],
                 by[3 * stride]);
    }
    for (; k < count; k++)
        add_scaled(to, rows + k * pitch, factors[k * stride], n);
}

/* Add the combination of the rows `which` (count,) of `rows`, of length n, to another one, by as many factors. */
static inline void add_selected(double *restrict to, int64_t n, const double *rows, const int64_t *which,
                                const double *factors, int64_t count)
{
    int64_t k = 0;
    for (; k + 4 <= count; k += 4)
        add_four(to, n, rows + which[k] * n, rows + which[k + 1] * n, rows + which[k + 2] * n, rows + which[k + 3] * n,
                 factors[k], factors[k + 1], factors[k + 2], factors[k + 3]);
    for (; k + 2 <= count; k += 2)
        add_two(to, n, rows + which[k] * n, rows + which[k + 1] * n, factors[k], factors[k + 1]);
    for (; k < count; k++)
        add_scaled(to, rows + which[k] * n, factors[k], n);
}

/* out = a b, (n, m) (m, w). */
static inline void multiply(const double *a, const double *b, int64_t n, int64_t m, int64_t w, double *restrict out)
{
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < w; j++)
            out[i * w + j] = 0.0;
        add_combination(out + i * w, w, b, w, a + i * m, 1, m);
    }
}

/* out = a b^T, (n, m) (w, m). */
static inline void multiply_transposed(const double *a, const double *b, int64_t n, int64_t m, int64_t w,
                                       double *restrict out)
{
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < w; j++)
            out[i * w + j] = dot(a + i * m, b + j * m, m);
}

/* Solve a x = b by Gauss with the largest pivots of columns, in place of both; false where `a` is singular. */
static inline bool solve(double *a, double *b, int64_t n)
{
    for (int64_t column = 0; column < n; column++) {
        int64_t pivot = column;
        for (int64_t row = column + 1; row < n; row++)
            if (fabs(a[row * n + column]) > fabs(a[pivot * n + column]))
                pivot = row;
        if (!(fabs(a[pivot * n + column]) > 0.0))
            return false;
        for (int64_t k = column; k < n && pivot != column; k++) {
            double kept = a[pivot * n + k];
            a[pivot * n + k] = a[column * n + k];
            a[column * n + k] = kept;
        }
        double kept = b[pivot];
        b[pivot] = b[column];
        b[column] = kept;
        for (int64_t row = column + 1; row < n; row++) {
            double factor = a[row * n + column] / a[column * n + column];
            add_scaled(a + row * n + column, a + column * n + column, -factor, n - column);
            b[row] -= factor * b[column];
        }
    }
    for (int64_t row = n - 1; row >= 0; row--) {
        for (int64_t k = row + 1; k < n; k++)
            b[row] -= a[row * n + k] * b[k];
        b[row] /= a[row * n + row];
    }
    return true;
}

/* out = a^-1 of a symmetric, positive definite matrix by its Cholesky factor, of which the inverse stays in the lower
 * half of `a`; false, and all of it not a number, where `a` is not positive definite or not finite. */
static inline bool invert_positive(double *restrict a, int64_t n, double *restrict out)
{
    bool positive = true;
    for (int64_t r = 0; r < n && positive; r++) {
        double *row = a + r * n;
        for (int64_t q = 0; q < r; q++)
            row[q] = (row[q] - dot(row, a + q * n, q)) * a[q * n + q];
        double pivot = row[r] - dot(row, row, r);
        positive = 0.0 < pivot && pivot < INFINITY;
        row[r] = 1.0 / sqrt(pivot);
    }
    for (int64_t i = 0; i < n * n; i++)
        out[i] = positive ? 0.0 : NAN;
    for (int64_t r = 0; r < n; r++) { /* the factor's inverse, row after row, from the rows above */
        double *row = a + r * n;
        for (int64_t q = 0; q < r; q++) {
            double total = 0.0;
            for (int64_t j = q; j < r; j++)
                total -= row[j] * a[j * n + q];
            row[q] = total * row[r];
        }
        for (int64_t i = 0; i <= r; i++)
            add_scaled(out + i * n, row, row[i], i + 1);
    }
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < i; j++)
            out[j * n + i] = out[i * n + j];
    return positive;
}

#endif
