/* The forward pass of proprio_ros/sim/sphere.py for a box in plain C: the yardstick for its Warp kernel.
 *
 * The same law (ramped), the same friction of the joint, the same steps: RK4 between events (samples and changes of the
 * current), smaller steps near standstill where there is dry friction. A revolute joint; no load that changes with time.
 */

#include <math.h>

#define PARAMETERS 23 /* the order of SPHERE_PARAMETERS */
#define GEOMETRY 22   /* one row of the simulator's geometry */
#define TIME_EPS 1e-9

typedef struct {
    double q, v, x[3], u[3], s[3];
} State; /* as rates: velocity, acceleration, and the sphere's */

typedef struct {
    const double *p;         /* parameters */
    const double *constants; /* volt, emf, ohm, friction velocity, step, fine step */
    const double *geometry;  /* axis 0, origin 3, turn 6, gravity 7, by cos 10, by sin 13, half 16, radius 19, kappa 20, ramp 21 */
} Law;

static inline double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double current(double command, double v, const double *supply)
{
    if (supply[0] > 0.0) {
        const double high = (supply[0] - supply[1] * v) / supply[2];
        const double low = -(supply[0] + supply[1] * v) / supply[2];
        if (command > 0.0 && command > high)
            return high > 0.0 ? high : 0.0;
        if (command < 0.0 && command < low)
            return low < 0.0 ? low : 0.0;
    }
    return command;
}

static inline double acceleration(const Law *law, double q, double v, double command, double extra)
{
    const double *p = law->p;
    const double motor = p[4] * current(command, v, law->constants);
    double dry = p[5] + p[7] * fabs(motor);
    if (p[13] > 0.0) {
        const double slow = v / p[13];
        dry *= 1.0 + p[12] * exp(-slow * slow);
    }
    const double friction = dry * tanh(v / law->constants[3]) + p[6] * v;
    const double load = p[1] * cos(q) + p[2] * sin(q) + p[3] + extra;
    return (motor - friction - load) / p[0];
}

/* One wall: adds what it does to the sphere and to the joint. */
static inline void touch(const Law *law, const State *y, double depth, const double *n, double *push, double *spin,
                         double *reaction)
{
    const double *p = law->p, *axis = law->geometry, *origin = law->geometry + 3;
    const double radius = law->geometry[19], kappa = law->geometry[20], ramp = depth / law->geometry[21];
    const double k = p[18], c = p[19], kf = p[20], mu = p[21];
    double arm[3], lever[3], rolled[3], relative[3], slip[3], f[3], torque[3];
    for (int i = 0; i < 3; ++i)
        arm[i] = y->x[i] - radius * n[i] - origin[i];
    cross(axis, arm, lever);
    cross(y->s, n, rolled);
    for (int i = 0; i < 3; ++i)
        relative[i] = y->u[i] - radius * rolled[i] - y->v * lever[i];
    const double v_n = dot(relative, n);
    for (int i = 0; i < 3; ++i)
        slip[i] = relative[i] - v_n * n[i];
    double normal = k * depth - c * (ramp < 1.0 ? ramp : 1.0) * v_n;
    normal = normal > 0.0 ? normal : 0.0;
    const double most = mu * normal;
    const double bottom = sqrt(kf * kf * dot(slip, slip) + most * most);
    const double scale = bottom > 0.0 ? kf * most / bottom : 0.0;
    for (int i = 0; i < 3; ++i)
        f[i] = normal * n[i] - scale * slip[i];
    cross(n, f, torque);
    for (int i = 0; i < 3; ++i) {
        push[i] += f[i];
        spin[i] -= torque[i] / (kappa * radius);
    }
    *reaction += dot(lever, f);
}

static inline void rates(const Law *law, const State *y, double command, State *dy)
{
    const double *g = law->geometry, *axis = g;
    const double angle = y->q + law->p[22], cosine = cos(angle), sine = sin(angle);
    double push[3], spin[3] = {0.0, 0.0, 0.0}, reaction = 0.0;
    for (int i = 0; i < 3; ++i)
        push[i] = g[7 + i] + cosine * g[10 + i] + sine * g[13 + i];
    for (int i = 0; i < 3; ++i)
        for (int side = 1; side >= -1; side -= 2) {
            const double depth = g[19] - g[16 + i] - side * y->x[i];
            if (depth > 0.0) {
                double n[3] = {0.0, 0.0, 0.0};
                n[i] = side;
                touch(law, y, depth, n, push, spin, &reaction);
            }
        }
    double arm[3], lever[3], turning[3], coriolis[3], turned[3];
    for (int i = 0; i < 3; ++i) {
        arm[i] = y->x[i] - g[3 + i];
        turning[i] = y->v * axis[i];
    }
    cross(axis, arm, lever);
    cross(turning, y->u, coriolis);
    cross(turning, y->s, turned);
    dy->q = y->v;
    dy->v = acceleration(law, y->q, y->v, command, law->p[14] * reaction);
    for (int i = 0; i < 3; ++i) {
        dy->x[i] = y->u[i] - y->v * lever[i];
        dy->u[i] = push[i] - coriolis[i];
        dy->s[i] = spin[i] - turned[i];
    }
}

static inline void moved(const State *y, double h, const State *dy, State *out)
{
    out->q = y->q + h * dy->q;
    out->v = y->v + h * dy->v;
    for (int i = 0; i < 3; ++i) {
        out->x[i] = y->x[i] + h * dy->x[i];
        out->u[i] = y->u[i] + h * dy->u[i];
        out->s[i] = y->s[i] + h * dy->s[i];
    }
}

static inline void weighted(const State *a, const State *b, const State *c, const State *d, State *out)
{
    out->q = a->q + 2.0 * b->q + 2.0 * c->q + d->q;
    out->v = a->v + 2.0 * b->v + 2.0 * c->v + d->v;
    for (int i = 0; i < 3; ++i) {
        out->x[i] = a->x[i] + 2.0 * b->x[i] + 2.0 * c->x[i] + d->x[i];
        out->u[i] = a->u[i] + 2.0 * b->u[i] + 2.0 * c->u[i] + d->u[i];
        out->s[i] = a->s[i] + 2.0 * b->s[i] + 2.0 * c->s[i] + d->s[i];
    }
}

/* One run, `worlds` guesses. p (worlds, 23); q and v (worlds, samples), x, u and s (worlds, samples, 3). */
void sphere_pass(int worlds, int samples, const double *sample_times, int segments, const double *input_times,
                 const double *input_current, const double *constants, const double *geometry, const double *p_in,
                 double *q_out, double *v_out, double *x_out, double *u_out, double *s_out)
{
    const double coarse = constants[4], fine = constants[5], vs = constants[3];
    for (int w = 0; w < worlds; ++w) {
        const Law law = {p_in + w * PARAMETERS, constants, geometry};
        const double delay = law.p[8], v0 = law.p[10];
        State y = {law.p[9], v0, {law.p[15], law.p[16], law.p[17]}, {0.0}, {0.0}};
        double arm[3], lever[3], t = 0.0;
        int segment = 0;
        double command = input_current[0];
        for (int i = 0; i < 3; ++i)
            arm[i] = y.x[i] - geometry[3 + i];
        cross(geometry, arm, lever);
        for (int i = 0; i < 3; ++i) {
            y.u[i] = v0 * lever[i];
            y.s[i] = v0 * geometry[i];
        }
        for (int k = 0; k < samples; ++k) {
            const double goal = sample_times[k] - delay;
            const long row = (long)w * samples + k;
            double seen = y.q + y.v * goal;
            if (goal > 0.0) {
                for (int arrived = 0; !arrived;) {
                    double end = goal;
                    int switches = 0;
                    if (segment + 1 < segments && input_times[segment + 1] < goal) {
                        end = input_times[segment + 1];
                        switches = 1;
                    }
                    for (int last = 0; !last;) {
                        State d1, d2, d3, d4, y2, sum;
                        double h = coarse;
                        rates(&law, &y, command, &d1);
                        if (fine < coarse && fabs(y.v) < 20.0 * vs + fabs(d1.v) * coarse)
                            h = fine;
                        if (t + h > end - TIME_EPS) {
                            h = end - t;
                            last = 1;
                        }
                        moved(&y, 0.5 * h, &d1, &y2);
                        rates(&law, &y2, command, &d2);
                        moved(&y, 0.5 * h, &d2, &y2);
                        rates(&law, &y2, command, &d3);
                        moved(&y, h, &d3, &y2);
                        rates(&law, &y2, command, &d4);
                        weighted(&d1, &d2, &d3, &d4, &sum);
                        moved(&y, h / 6.0, &sum, &y);
                        t = last ? end : t + h;
                    }
                    if (switches)
                        command = input_current[++segment];
                    else
                        arrived = 1;
                }
                seen = y.q;
            }
            q_out[row] = seen;
            v_out[row] = y.v;
            for (int i = 0; i < 3; ++i) {
                x_out[3 * row + i] = y.x[i];
                u_out[3 * row + i] = y.u[i];
                s_out[3 * row + i] = y.s[i];
            }
        }
    }
}
