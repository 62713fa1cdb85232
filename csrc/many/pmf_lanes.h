/* Several axes at once: the types and choices of pmf.h for vectors with one element per axis.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Every operation on a vector is the same IEEE operation on each element, so that each axis has the bits of the
 * scalar kernel. If axes take different branches, both branches are computed, and each axis chooses one. The file needs
 * the vector extensions of gcc or clang. PMF_LANES is the number of axes, PMF_LANE_BYTES the number of bytes. Integers
 * are as wide as reals, so that one kind of truth (all bits set or none) fits both. Values that count modulo 2^32 are
 * masked. */
#ifndef PMF_LANES_H
#define PMF_LANES_H

#ifdef PMF_FLOAT32
typedef uint32_t lane_whole_t;
typedef int32_t lane_integer_t;
#else
typedef uint64_t lane_whole_t;
typedef int64_t lane_integer_t;
#endif

typedef scalar_t real_t __attribute__((vector_size(PMF_LANE_BYTES)));
typedef lane_whole_t whole_t __attribute__((vector_size(PMF_LANE_BYTES)));
typedef lane_integer_t integer_t __attribute__((vector_size(PMF_LANE_BYTES)));
typedef integer_t truth_t;
typedef truth_t word_t __attribute__((may_alias)); /* any vector of a structure */
typedef long long words_t __attribute__((vector_size(PMF_LANE_BYTES)));
typedef int32_t narrow_t __attribute__((vector_size(PMF_LANES * 4)));

#define PMF_API static __attribute__((unused))

/* x - 0 is x to the last bit, and the compiler copies x to every lane. */
#define PMF_ALIKE(x) ((x) - (real_t){0})
#define PMF_R(x) PMF_ALIKE(PMF_SCALAR(x))
#define PMF_W(x) ((whole_t){0} + (x))
/* All integers that become real fit 32 bits, for which processors have a conversion. */
#define PMF_TO_REAL(x) __builtin_convertvector(__builtin_convertvector((x), narrow_t), real_t)

#define PMF_TYPE(yes, no) __typeof__((yes) - (no))
#define PMF_BITS(type, x) ((truth_t)((x) - (type){0}))
#define PMF_IF(truth, yes, no) \
    ((PMF_TYPE(yes, no))((PMF_BITS(PMF_TYPE(yes, no), yes) & (truth)) | (PMF_BITS(PMF_TYPE(yes, no), no) & ~(truth))))
#define PMF_SIZE(x) ((real_t)((truth_t)(x) & ~(truth_t)PMF_R(-0.0)))
#define PMF_WIDTH PMF_LANES
/* Lanes have no separate functions, because a call would move their vectors to memory and back. */
#define PMF_APART static inline __attribute__((always_inline))
#define PMF_LANE(x, lane) ((x)[lane])
#define PMF_ANY(truth) pmf_any(truth)
#define PMF_ALL(truth) (!pmf_any(~(truth)))
#define PMF_WHERE(truth, object, action)                       \
    do {                                                       \
        truth_t where_ = (truth);                              \
        if (PMF_ALL(where_)) {                                 \
            action;                                            \
        } else if (PMF_ANY(where_)) {                          \
            __typeof__(*(object)) kept_ = *(object);           \
            action;                                            \
            pmf_restore(where_, object, &kept_, sizeof kept_); \
        }                                                      \
    } while (0)

/* These are the names of the instructions in gcc and clang. The header immintrin.h has functions for the instructions,
 * but reading it would take a fifth of the compiler's time. */
static inline int pmf_any(truth_t truth)
{
#if defined(__AVX512F__)
    return __builtin_ia32_cmpq512_mask((words_t)truth, (words_t){0}, 4 /* not equal */, 255) != 0;
#elif defined(__AVX2__)
    return !__builtin_ia32_ptestz256((words_t)truth, (words_t)truth);
#else
    lane_integer_t any = 0;
    uint32_t i;
    for (i = 0; i < PMF_LANES; ++i) {
        any |= truth[i];
    }
    return any != 0;
#endif
}

static __attribute__((unused)) void pmf_clear(void *memory, uint32_t size)
{
    word_t *word = (word_t *)memory;
    uint32_t i;
    for (i = 0; i < size / PMF_LANE_BYTES; ++i) {
        word[i] = (truth_t){0};
    }
}

/* Restore the words of the axes for which the truth does not hold. */
static inline void pmf_restore(truth_t truth, void *object, const void *kept, uint64_t size)
{
    word_t *now = (word_t *)object;
    const word_t *before = (const word_t *)kept;
    uint64_t i;
    for (i = 0; i < size / PMF_LANE_BYTES; ++i) {
        now[i] = (now[i] & truth) | (before[i] & ~truth);
    }
}

#endif
