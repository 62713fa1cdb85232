/* A sample in a file of samples, and the age of its last edge as an argument. */
typedef struct {
#if PMF_WITH_STEPS
    real_t step;
#endif
#ifdef PMF_WITH_EDGES
#define AGE , input.age
    real_t age;
#else
#define AGE
#endif
    real_t u;
    uint32_t count;
} input_t;
