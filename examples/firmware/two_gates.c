/* Key sensor firmware on a test bench: one sample at a time, no memory of the record.
 *
 *     cc -O2 -o two_gates two_gates.c
 *     feltmb keyboard score stream:./two_gates --sensor linear --count 100
 *
 * sample() is what runs in the instrument; main() is the bench. The speed is that between two gates,
 * 85 % and 95 % of the way to the string, for a sensor whose reading rises in proportion. */
#include <stdio.h>

typedef struct {
    double rate, reach, first, full; /* Hz, m, travel at count 0, and travel of one count */
    double last;                     /* travel of the sample before */
    double start;                    /* samples since the first gate; negative: not passed */
} State;

/* Speed at the string [m/s] if the hammer passed the second gate, or else 0; `early` is the time
 * since then in samples. */
static double sample(State *s, int count, double *early) {
    const double low = 0.85, high = 0.95;
    const double travel = s->first + count * s->full, step = travel - s->last;
    double speed = 0.0;
    if (s->start >= 0.0)
        s->start += 1.0;
    if (s->last < low && travel >= low)
        s->start = (travel - low) / step;
    if (s->last < high && travel >= high && s->start > 0.0) {
        *early = (travel - high) / step;
        speed = (high - low) * s->reach * s->rate / (s->start - *early);
        s->start = -1.0;
    }
    if (travel < low)
        s->start = -1.0;
    s->last = travel;
    return speed;
}

int main(void) {
    char line[4096];
    double start, bits, low, high, rate, reach, early, end;
    State state = {0.0, 0.0, 0.0, 0.0, 0.0, -1.0};
    long at = 0;
    int count;
    puts("time,speed");
    while (fgets(line, sizeof line, stdin)) {
        if (sscanf(line, "# rate=%lf start=%lf bits=%lf low=%lf high=%lf reach=%lf", &rate, &start,
                   &bits, &low, &high, &reach) == 6)
            state = (State){rate, reach, low, (high - low) / ((1L << (int)bits) - 1), 0.0, -1.0};
        else if (sscanf(line, "# travel=0,%lf", &end) == 1) {
            state.first *= end; /* travel at the full scale of the reading */
            state.full *= end;
        } else if (sscanf(line, "%d", &count) == 1) {
            const double speed = sample(&state, count, &early);
            if (speed > 0.0)
                printf("%.6f,%.5f\n", start + ((double)at - early) / rate + 0.05 * reach / speed, speed);
            at++;
        }
    }
    return 0;
}
