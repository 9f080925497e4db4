/* What moves in an upright cylinder, in the cylinder's own frame (origin amid its bottom, z along its axis).

   A liquid: particles that carry velocity and its gradient to a staggered grid and back (APIC: Jiang, Schroeder, Selle, Teran and
   Stomakhin 2015, "The affine particle-in-cell method"), made free of divergence there by a pressure; the wall cuts cells
   by the open share of their faces (Ng, Min and Gibou 2009), the surface lies between cells (ghost fluid: Gibou, Fedkiw, Cheng and
   Kang 2002). Viscosity is explicit, walls hold the liquid.
   Grains: spheres with linear springs, dashpots and Coulomb friction with memory (Cundall and Strack 1979).

   Both are driven by gravity and by the motion of the frame, and tell the mean force and moment (about the origin) on the cylinder. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef double vec[3];

typedef struct { double g[3], a[3], alpha[3], omega[3]; } Frame; /* gravity, and the origin's motion, in the frame's axes */

static void cross(const double *a, const double *b, double *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

/* acceleration that a free body at x with velocity v has in the frame */
static void apparent(const Frame *f, const double *x, const double *v, double *b)
{
    vec spin, centrifugal, coriolis, euler;
    cross(f->omega, x, spin), cross(f->omega, spin, centrifugal), cross(f->omega, v, coriolis), cross(f->alpha, x, euler);
    for (int i = 0; i < 3; i++) b[i] = f->g[i] - f->a[i] - euler[i] - centrifugal[i] - 2.0 * coriolis[i];
}

/* ---- liquid ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    int n, nx, ny, nz, cells, stride[3];
    double dx, radius, height, nu, kg, *x, *v, *c; /* kg: of a particle */
    double *u[3], *weight[3], *open[3], *spare, *wall[3][6];
    char *valid[3];
    double *full, *depth, *p, *r, *s, *q, *diagonal;
    char *wet;
    int *inside, count; /* wet cells */
} Liquid;

static void place(const Liquid *l, int a, int i, int j, int k, double *x)
{
    x[0] = (i - l->nx / 2 + (a != 0) * 0.5) * l->dx, x[1] = (j - l->ny / 2 + (a != 1) * 0.5) * l->dx;
    x[2] = (k - 1 + (a != 2) * 0.5) * l->dx;
}

/* eight nodes about a point for component a (3: centres of cells), their weights, and gradients of these */
static int nodes(const Liquid *l, int a, const double *x, double *w, double (*dw)[3])
{
    double at[3] = {x[0] / l->dx + l->nx / 2, x[1] / l->dx + l->ny / 2, x[2] / l->dx + 1.0}, t[3];
    int base = 0;
    for (int d = 0; d < 3; d++) {
        if (d != a) at[d] -= 0.5;
        int whole = (int)floor(at[d]);
        t[d] = at[d] - whole;
        base += whole * l->stride[d];
    }
    for (int m = 0; m < 8; m++) {
        double f[3], s[3];
        for (int d = 0; d < 3; d++) {
            int up = m >> d & 1;
            f[d] = up ? t[d] : 1.0 - t[d], s[d] = (up ? 1.0 : -1.0) / l->dx;
        }
        w[m] = f[0] * f[1] * f[2];
        if (dw) dw[m][0] = s[0] * f[1] * f[2], dw[m][1] = f[0] * s[1] * f[2], dw[m][2] = f[0] * f[1] * s[2];
    }
    return base;
}

static int corner(const Liquid *l, int m) { return (m & 1) * l->stride[0] + (m >> 1 & 1) * l->stride[1] + (m >> 2 & 1); }

Liquid *liquid_new(int n, const double *x, double radius, double height, int layers, double nu, double kg)
{
    Liquid *l = calloc(1, sizeof *l);
    l->n = n, l->radius = radius, l->height = height, l->nu = nu, l->kg = kg, l->dx = height / layers;
    l->nx = l->ny = 2 * (int)ceil(radius / l->dx) + 6, l->nz = layers + 4, l->cells = l->nx * l->ny * l->nz;
    l->stride[0] = l->ny * l->nz, l->stride[1] = l->nz, l->stride[2] = 1;
    size_t bytes = l->cells * sizeof(double);
    l->x = calloc(3 * n, sizeof(double)), l->v = calloc(3 * n, sizeof(double)), l->c = calloc(9 * n, sizeof(double));
    memcpy(l->x, x, 3 * n * sizeof(double));
    for (int a = 0; a < 3; a++) {
        l->u[a] = calloc(1, bytes), l->weight[a] = calloc(1, bytes), l->open[a] = calloc(1, bytes), l->valid[a] = calloc(1, l->cells);
        for (int d = 0; d < 6; d++) l->wall[a][d] = calloc(1, bytes);
    }
    double **more[] = {&l->full, &l->depth, &l->p, &l->r, &l->s, &l->q, &l->diagonal, &l->spare};
    for (int m = 0; m < 8; m++) *more[m] = calloc(1, bytes);
    l->wet = calloc(1, l->cells), l->inside = calloc(l->cells, sizeof(int));
    const int fine = 16;
    for (int i = 0; i < l->nx; i++) for (int j = 0; j < l->ny; j++) for (int k = 1; k <= layers + 1; k++) {
        int at = i * l->stride[0] + j * l->stride[1] + k;
        double disc = 0.0, w[8], c[3];
        place(l, 3, i, j, k, c);
        for (int m = 0; m < fine; m++) for (int o = 0; o < fine; o++) {
            double y[3] = {c[0] + ((m + 0.5) / fine - 0.5) * l->dx, c[1] + ((o + 0.5) / fine - 0.5) * l->dx, c[2]};
            if (hypot(y[0], y[1]) > radius) continue;
            disc += 1.0 / (fine * fine);
            for (int b = 0; b < 8 && k <= layers; b++) {
                y[2] = c[2] + ((b + 0.5) / 8 - 0.5) * l->dx;
                int base = nodes(l, 3, y, w, NULL);
                for (int e = 0; e < 8; e++) l->full[base + corner(l, e)] += w[e] / (8.0 * fine * fine);
            }
        }
        if (k > 1 && k <= layers && disc > 1e-3) l->open[2][at] = disc;
        for (int a = 0; a < 2 && k <= layers; a++) {
            double f[3];
            place(l, a, i, j, k, f);
            double half = sqrt(fmax(0.0, radius * radius - f[a] * f[a])), side = f[1 - a];
            double inside = fmin(half, side + 0.5 * l->dx) - fmax(-half, side - 0.5 * l->dx);
            l->open[a][at] = inside > 1e-3 * l->dx ? inside / l->dx : 0.0; /* a wall along a face leaves no slit */
        }
    }
    for (int i = 1; i < l->nx - 1; i++) for (int j = 1; j < l->ny - 1; j++) for (int k = 1; k <= layers; k++) for (int a = 0; a < 3; a++) {
        int at = i * l->stride[0] + j * l->stride[1] + k;
        double f[3];
        place(l, a, i, j, k, f);
        for (int d = 0; d < 6; d++) {
            int axis = d / 2, other = at + (d % 2 ? 1 : -1) * l->stride[axis];
            if (l->open[a][at] <= 0.0 || l->open[a][other] > 0.0) continue; /* 0: no wall there */
            double reach = l->dx;
            if (axis == 2) reach = a == 2 ? l->dx : 0.5 * l->dx;
            else reach = sqrt(fmax(0.0, radius * radius - f[1 - axis] * f[1 - axis])) + (d % 2 ? -f[axis] : f[axis]);
            l->wall[a][d][at] = fmin(fmax(reach, 0.25 * l->dx), l->dx);
        }
    }
    return l;
}

void liquid_free(Liquid *l)
{
    for (int a = 0; a < 3; a++) {
        free(l->u[a]), free(l->weight[a]), free(l->open[a]), free(l->valid[a]);
        for (int d = 0; d < 6; d++) free(l->wall[a][d]);
    }
    double *more[] = {l->full, l->depth, l->p, l->r, l->s, l->q, l->diagonal, l->spare, l->x, l->v, l->c};
    for (int m = 0; m < 11; m++) free(more[m]);
    free(l->wet), free(l->inside), free(l);
}

double *liquid_places(Liquid *l) { return l->x; }
double *liquid_velocities(Liquid *l) { return l->v; }
double *liquid_gradients(Liquid *l) { return l->c; }

static void to_grid(Liquid *l, double kg_m3)
{
    double w[8], volume = l->kg / kg_m3 / (l->dx * l->dx * l->dx);
    memset(l->depth, 0, l->cells * sizeof(double));
    for (int a = 0; a < 3; a++) memset(l->u[a], 0, l->cells * sizeof(double)), memset(l->weight[a], 0, l->cells * sizeof(double));
    for (int n = 0; n < l->n; n++) {
        const double *x = l->x + 3 * n;
        for (int a = 0; a < 3; a++) {
            const double *c = l->c + 9 * n + 3 * a;
            int base = nodes(l, a, x, w, NULL);
            double at[3] = {x[0] / l->dx + l->nx / 2, x[1] / l->dx + l->ny / 2, x[2] / l->dx + 1.0}, t[3];
            for (int d = 0; d < 3; d++) at[d] -= d != a ? 0.5 : 0.0, t[d] = at[d] - floor(at[d]);
            double v = l->v[3 * n + a];
            for (int m = 0; m < 8; m++) {
                double there = v;
                for (int d = 0; d < 3; d++) there += c[d] * ((m >> d & 1) - t[d]) * l->dx;
                int at_m = base + corner(l, m);
                l->u[a][at_m] += w[m] * there, l->weight[a][at_m] += w[m];
            }
        }
        int base = nodes(l, 3, x, w, NULL);
        for (int m = 0; m < 8; m++) l->depth[base + corner(l, m)] += w[m] * volume;
    }
    for (int a = 0; a < 3; a++) for (int m = 0; m < l->cells; m++) if (l->weight[a][m] > 1e-9) l->u[a][m] /= l->weight[a][m];
    /* filled share to depth below the surface, in cells: exact under a level surface */
    for (int m = 0; m < l->cells; m++) {
        double f = l->full[m] > 0.02 ? l->depth[m] / l->full[m] : 0.0;
        l->depth[m] = f > 0.5 ? 1.0 - sqrt(2.0 * fmax(0.0, 1.0 - f)) : sqrt(2.0 * f) - 1.0;
    }
}

static void viscosity(Liquid *l, double dt)
{
    const double share = l->nu * dt / l->dx;
    for (int a = 0; a < 3; a++) {
        double *u = l->u[a];
        memcpy(l->spare, u, l->cells * sizeof(double));
        for (int m = l->stride[0]; m < l->cells - l->stride[0]; m++) {
            if (l->weight[a][m] <= 1e-9 || l->open[a][m] <= 0.0) continue;
            double sum = 0.0;
            for (int d = 0; d < 6; d++) {
                int o = m + (d % 2 ? 1 : -1) * l->stride[d / 2];
                if (l->wall[a][d][m] > 0.0) sum -= l->spare[m] / l->wall[a][d][m];
                else if (l->weight[a][o] > 1e-9 && l->open[a][o] > 0.0) sum += (l->spare[o] - l->spare[m]) / l->dx;
            }
            u[m] += share * sum;
        }
    }
}

static double conduct(const Liquid *l, int a, int face) /* of a face between a wet cell and its neighbour */
{
    int low = face - l->stride[a], high = face;
    if (l->wet[low] && l->wet[high]) return l->open[a][face];
    double in = l->wet[low] ? l->depth[low] : l->depth[high], out = l->wet[low] ? l->depth[high] : l->depth[low];
    return l->open[a][face] / fmax(0.1, in / (in - out));
}

static void apply(const Liquid *l, const double *s, double *q) /* s is nought in dry cells */
{
    for (int i = 0; i < l->count; i++) {
        const int m = l->inside[i];
        double sum = l->diagonal[m] * s[m];
        for (int a = 0; a < 3; a++) {
            const int d = l->stride[a];
            sum -= l->open[a][m] * s[m - d] + l->open[a][m + d] * s[m + d];
        }
        q[m] = sum;
    }
}

static void project(Liquid *l)
{
    const int first = l->stride[0], last = l->cells - l->stride[0];
    double *p = l->p, *r = l->r, *s = l->s, *q = l->q;
    l->count = 0;
    for (int m = first; m < last; m++) {
        double open = 0.0;
        for (int a = 0; a < 3; a++) open += l->open[a][m] + l->open[a][m + l->stride[a]];
        l->wet[m] = l->depth[m] > 0.0 && open > 1e-6;
        if (l->wet[m]) l->inside[l->count++] = m;
        else p[m] = 0.0;
    }
    for (int m = first; m < last; m++) {
        l->diagonal[m] = r[m] = 0.0;
        if (!l->wet[m]) continue;
        for (int a = 0; a < 3; a++) {
            int d = l->stride[a];
            l->diagonal[m] += (l->open[a][m] > 0.0 ? conduct(l, a, m) : 0.0) + (l->open[a][m + d] > 0.0 ? conduct(l, a, m + d) : 0.0);
            r[m] -= l->open[a][m + d] * l->u[a][m + d] - l->open[a][m] * l->u[a][m];
        }
    }
    apply(l, p, q);
    double rho = 0.0, size = 0.0;
    memset(s, 0, l->cells * sizeof(double));
    for (int i = 0; i < l->count; i++) {
        int m = l->inside[i];
        size += r[m] * r[m] / l->diagonal[m];
        r[m] -= q[m], s[m] = r[m] / l->diagonal[m], rho += r[m] * s[m];
    }
    for (int turn = 0; turn < 400 && rho > 1e-10 * size + 1e-24; turn++) {
        apply(l, s, q);
        double curve = 0.0, next = 0.0;
        for (int i = 0; i < l->count; i++) curve += s[l->inside[i]] * q[l->inside[i]];
        double step = rho / curve;
        for (int i = 0; i < l->count; i++) {
            int m = l->inside[i];
            p[m] += step * s[m], r[m] -= step * q[m];
            next += r[m] * r[m] / l->diagonal[m];
        }
        for (int i = 0; i < l->count; i++) {
            int m = l->inside[i];
            s[m] = r[m] / l->diagonal[m] + next / rho * s[m];
        }
        rho = next;
    }
    for (int a = 0; a < 3; a++) {
        memset(l->valid[a], 0, l->cells);
        for (int m = first; m < last; m++) {
            int low = m - l->stride[a];
            if (l->open[a][m] <= 0.0 || (!l->wet[m] && !l->wet[low])) continue;
            double difference = (l->wet[m] ? p[m] : 0.0) - (l->wet[low] ? p[low] : 0.0);
            l->u[a][m] -= difference * conduct(l, a, m) / l->open[a][m];
            l->valid[a][m] = 1;
        }
    }
}

static void extend(Liquid *l)
{
    for (int a = 0; a < 3; a++) {
        for (int m = 0; m < l->cells; m++) if (!l->valid[a][m]) l->u[a][m] = 0.0;
        for (char layer = 1; layer <= 3; layer++) for (int m = l->stride[0]; m < l->cells - l->stride[0]; m++) {
            if (l->valid[a][m]) continue;
            double sum = 0.0;
            int count = 0;
            for (int d = 0; d < 6; d++) {
                int o = m + (d % 2 ? 1 : -1) * l->stride[d / 2];
                if (l->valid[a][o] && l->valid[a][o] <= layer) sum += l->u[a][o], count++;
            }
            if (count) l->u[a][m] = sum / count, l->valid[a][m] = layer + 1;
        }
    }
    /* nothing goes through the side, the bottom and the lid */
    for (int a = 0; a < 2; a++) {
        memcpy(a ? l->q : l->spare, l->u[a], l->cells * sizeof(double));
    }
    for (int i = 1; i < l->nx - 1; i++) for (int j = 1; j < l->ny - 1; j++) for (int k = 1; k < l->nz - 2; k++) for (int a = 0; a < 2; a++) {
        int at = i * l->stride[0] + j * l->stride[1] + k, b = 1 - a;
        double f[3], *mine = a ? l->q : l->spare, *theirs = a ? l->spare : l->q;
        place(l, a, i, j, k, f);
        double far = hypot(f[0], f[1]);
        if (far <= l->radius) continue;
        double side = 0.25 * (theirs[at] + theirs[at + l->stride[b]] + theirs[at - l->stride[a]] + theirs[at - l->stride[a] + l->stride[b]]);
        double out = (mine[at] * f[a] + side * f[b]) / far;
        l->u[a][at] = mine[at] - out * f[a] / far;
    }
    int top = l->nz - 3;
    for (int i = 0; i < l->nx; i++) for (int j = 0; j < l->ny; j++) {
        double *column = l->u[2] + i * l->stride[0] + j * l->stride[1];
        column[0] = column[1] = column[top] = column[top + 1] = 0.0;
    }
}

/* one step; out: mean force and moment on the cylinder */
void liquid_step(Liquid *l, const double *frame, double dt, double kg_m3, double *out)
{
    const Frame *f = (const Frame *)frame;
    double w[8], dw[8][3], before[6] = {0}, after[6] = {0}, given[6] = {0};
    vec b, turn;
    for (int n = 0; n < l->n; n++) {
        double *x = l->x + 3 * n, *v = l->v + 3 * n;
        apparent(f, x, v, b);
        for (int d = 0; d < 3; d++) before[d] += v[d], given[d] += dt * b[d];
        cross(x, v, turn);
        for (int d = 0; d < 3; d++) before[3 + d] += turn[d];
        cross(x, b, turn);
        for (int d = 0; d < 3; d++) given[3 + d] += dt * turn[d], v[d] += dt * b[d];
    }
    to_grid(l, kg_m3);
    const int turns = (int)ceil(l->nu * dt / (0.08 * l->dx * l->dx)); /* explicit, with walls as near as a quarter of a cell */
    for (int turn_of = 0; turn_of < turns; turn_of++) viscosity(l, dt / turns);
    project(l), extend(l);
    const double rim = l->radius - 1e-3 * l->dx, low = 1e-3 * l->dx;
    for (int n = 0; n < l->n; n++) {
        double *x = l->x + 3 * n, *v = l->v + 3 * n, *c = l->c + 9 * n;
        for (int a = 0; a < 3; a++) {
            int base = nodes(l, a, x, w, dw);
            v[a] = c[3 * a] = c[3 * a + 1] = c[3 * a + 2] = 0.0;
            for (int m = 0; m < 8; m++) {
                double u = l->u[a][base + corner(l, m)];
                v[a] += w[m] * u;
                for (int d = 0; d < 3; d++) c[3 * a + d] += dw[m][d] * u;
            }
        }
        cross(x, v, turn);
        for (int d = 0; d < 3; d++) after[d] += v[d], after[3 + d] += turn[d], x[d] += dt * v[d];
        double far = hypot(x[0], x[1]);
        if (far > rim) x[0] *= rim / far, x[1] *= rim / far;
        x[2] = fmin(fmax(x[2], low), l->height - low);
    }
    for (int d = 0; d < 6; d++) out[d] = l->kg * (given[d] - (after[d] - before[d])) / dt;
}

/* ---- grains ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    int n, pairs, most, *pair, age;
    double radius, height, ball, kg, stiffness, damping, friction, rolling;
    double *x, *v, *w, *f, *t;
    float *memory, *walls; /* tangential springs of pairs (n, n, 3) and of the three walls (n, 3, 3) */
} Grains;

Grains *grains_new(int n, const double *x, double radius, double height, double ball, double kg, const double *touch)
{
    Grains *s = calloc(1, sizeof *s);
    s->n = n, s->radius = radius, s->height = height, s->ball = ball, s->kg = kg, s->most = 12 * n;
    s->stiffness = touch[0], s->damping = touch[1], s->friction = touch[2], s->rolling = touch[3];
    double **arrays[] = {&s->x, &s->v, &s->w, &s->f, &s->t};
    for (int m = 0; m < 5; m++) *arrays[m] = calloc(3 * n, sizeof(double));
    memcpy(s->x, x, 3 * n * sizeof(double));
    s->pair = calloc(2 * s->most, sizeof(int));
    s->memory = calloc((size_t)3 * n * n, sizeof(float)), s->walls = calloc(9 * n, sizeof(float));
    return s;
}

void grains_free(Grains *s)
{
    free(s->x), free(s->v), free(s->w), free(s->f), free(s->t), free(s->pair), free(s->memory), free(s->walls), free(s);
}

double *grains_places(Grains *s) { return s->x; }
double *grains_velocities(Grains *s) { return s->v; }

/* force on the first body of a touch: overlap, normal from the other to it, velocity against the other at the touch */
static double touching(const Grains *s, double overlap, const double *n, const double *v, double kg, float *memory, double dt, double *force)
{
    double vn = v[0] * n[0] + v[1] * n[1] + v[2] * n[2], along = 0.0, size = 0.0;
    double dash = s->damping * 2.0 * sqrt(s->stiffness * kg), fn = fmax(0.0, s->stiffness * overlap - dash * vn);
    double ft[3], kt = 0.8 * s->stiffness;
    for (int d = 0; d < 3; d++) memory[d] += dt * (v[d] - vn * n[d]), along += memory[d] * n[d];
    for (int d = 0; d < 3; d++) {
        memory[d] -= along * n[d];
        ft[d] = -kt * memory[d] - dash * (v[d] - vn * n[d]);
        size += ft[d] * ft[d];
    }
    size = sqrt(size);
    if (size > s->friction * fn) {
        double scale = size > 0.0 ? s->friction * fn / size : 0.0;
        for (int d = 0; d < 3; d++) ft[d] *= scale, memory[d] = (float)(-ft[d] / kt);
    }
    for (int d = 0; d < 3; d++) force[d] = fn * n[d] + ft[d];
    return fn;
}

static void neighbours(Grains *s)
{
    double reach = 2.0 * s->ball + 1e-3, reach2 = reach * reach;
    s->pairs = 0;
    for (int i = 0; i < s->n; i++) for (int j = 0; j < i; j++) {
        double dx = s->x[3 * i] - s->x[3 * j], dy = s->x[3 * i + 1] - s->x[3 * j + 1], dz = s->x[3 * i + 2] - s->x[3 * j + 2];
        if (dx * dx + dy * dy + dz * dz < reach2 && s->pairs < s->most) s->pair[2 * s->pairs] = i, s->pair[2 * s->pairs++ + 1] = j;
    }
}

/* several steps under one motion of the frame; out: mean force and moment on the cylinder */
void grains_step(Grains *s, const double *frame, double dt, int steps, double *out)
{
    const Frame *fr = (const Frame *)frame;
    const double inertia = 0.4 * s->kg * s->ball * s->ball;
    for (int d = 0; d < 6; d++) out[d] = 0.0;
    for (int step = 0; step < steps; step++) {
        if (s->age++ % 8 == 0) neighbours(s);
        for (int i = 0; i < s->n; i++) {
            double b[3];
            apparent(fr, s->x + 3 * i, s->v + 3 * i, b);
            for (int d = 0; d < 3; d++) s->f[3 * i + d] = s->kg * b[d], s->t[3 * i + d] = -inertia * fr->alpha[d];
        }
        for (int m = 0; m < s->pairs; m++) {
            int i = s->pair[2 * m], j = s->pair[2 * m + 1];
            double n[3], v[3], spin[3], arm[3], force[3], moment[3], far = 0.0;
            float *memory = s->memory + 3 * ((size_t)i * s->n + j);
            for (int d = 0; d < 3; d++) n[d] = s->x[3 * i + d] - s->x[3 * j + d], far += n[d] * n[d];
            far = sqrt(far);
            if (far >= 2.0 * s->ball) { memory[0] = memory[1] = memory[2] = 0.0f; continue; }
            for (int d = 0; d < 3; d++) n[d] /= far, arm[d] = -s->ball * n[d], spin[d] = s->w[3 * i + d] + s->w[3 * j + d];
            cross(spin, arm, v);
            for (int d = 0; d < 3; d++) v[d] += s->v[3 * i + d] - s->v[3 * j + d];
            double fn = touching(s, 2.0 * s->ball - far, n, v, 0.5 * s->kg, memory, dt, force);
            cross(arm, force, moment);
            for (int d = 0; d < 3; d++) {
                double rel = s->w[3 * i + d] - s->w[3 * j + d], roll = -s->rolling * fn * s->ball * rel / (fabs(rel) + 1.0);
                s->f[3 * i + d] += force[d], s->f[3 * j + d] -= force[d];
                s->t[3 * i + d] += moment[d] + roll, s->t[3 * j + d] += moment[d] - roll;
            }
        }
        for (int i = 0; i < s->n; i++) for (int wall = 0; wall < 3; wall++) {
            double *x = s->x + 3 * i, n[3] = {0.0, 0.0, 0.0}, v[3], arm[3], at[3], force[3], moment[3], overlap;
            float *memory = s->walls + 9 * i + 3 * wall;
            if (wall == 0) overlap = s->ball - x[2], n[2] = 1.0;
            else if (wall == 1) overlap = x[2] + s->ball - s->height, n[2] = -1.0;
            else {
                double far = hypot(x[0], x[1]);
                overlap = far + s->ball - s->radius;
                if (far > 1e-9) n[0] = -x[0] / far, n[1] = -x[1] / far;
            }
            if (overlap <= 0.0) { memory[0] = memory[1] = memory[2] = 0.0f; continue; }
            for (int d = 0; d < 3; d++) arm[d] = -s->ball * n[d], at[d] = x[d] + arm[d];
            cross(s->w + 3 * i, arm, v);
            for (int d = 0; d < 3; d++) v[d] += s->v[3 * i + d];
            double fn = touching(s, overlap, n, v, s->kg, memory, dt, force);
            cross(arm, force, moment);
            for (int d = 0; d < 3; d++) {
                double rel = s->w[3 * i + d];
                s->f[3 * i + d] += force[d], s->t[3 * i + d] += moment[d] - s->rolling * fn * s->ball * rel / (fabs(rel) + 1.0);
                out[d] -= force[d] / steps;
            }
            cross(at, force, moment);
            for (int d = 0; d < 3; d++) out[3 + d] -= moment[d] / steps;
        }
        for (int m = 0; m < 3 * s->n; m++) {
            s->v[m] += dt * s->f[m] / s->kg, s->x[m] += dt * s->v[m];
            s->w[m] += dt * s->t[m] / inertia;
        }
    }
}
