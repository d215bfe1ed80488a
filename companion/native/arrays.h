/* What the kernels see of a numpy array: its header as numpy lays it out, read but never written.
 *
 * numpy promises this layout to compiled code (PyArrayObject_fields), and library.py holds it against a known array
 * before anything else is called. So a call costs a tenth of a microsecond per array instead of one for its address.
 */
#ifndef SPANWISE_ARRAYS_H
#define SPANWISE_ARRAYS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define EXPORT __attribute__((visibility("default")))

enum { BAD_ARRAY = -1, NO_MEMORY = -2 }; /* what a kernel returns instead of its result */

typedef struct {
    void *object[2];
    void *type_object;
    char kind, type, byte_order;
} element_type;

typedef struct {
    void *object[2];
    char *data;
    int dimensions;
    const intptr_t *shape;
    const intptr_t *strides;
    void *base;
    const element_type *element;
    int flags;
} array;

/* Data of an array of these elements and so many dimensions, without gaps; otherwise NULL, and `good` becomes false. */
static inline void *array_data(const array *a, char type, int dimensions, bool *good)
{
    bool right = a->element->type == type || (type == 'l' && a->element->type == 'q');
    if (!right || a->element->byte_order == '>' || a->dimensions != dimensions || !(a->flags & 1)) {
        *good = false;
        return NULL;
    }
    return a->data;
}

static inline double *reals(const array *a, int dimensions, bool *good) { return array_data(a, 'd', dimensions, good); }

static inline int64_t *integers(const array *a, int dimensions, bool *good)
{
    return array_data(a, 'l', dimensions, good);
}

static inline uint8_t *truths(const array *a, int dimensions, bool *good)
{
    return array_data(a, '?', dimensions, good);
}

static inline uint8_t *bytes(const array *a, bool *good) { return array_data(a, 'B', 1, good); }

/* Length along an axis. */
static inline int64_t extent(const array *a, int axis) { return (int64_t)a->shape[axis]; }

static inline double least(double a, double b) { return a < b ? a : b; }

static inline double most(double a, double b) { return a > b ? a : b; }

static inline int64_t least_of(int64_t a, int64_t b) { return a < b ? a : b; }

static inline int64_t most_of(int64_t a, int64_t b) { return a > b ? a : b; }

/* Whether all of so many places are among first:end. */
static inline bool all_within(const int64_t *places, int64_t count, int64_t first, int64_t end)
{
    for (int64_t k = 0; k < count; k++)
        if (places[k] < first || places[k] >= end)
            return false;
    return true;
}

static inline double squared(double a) { return a * a; }

#endif
