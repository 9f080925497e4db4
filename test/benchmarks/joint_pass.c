/* One Jacobian pass of proprio_ros/sim/joint.py in plain C: the yardstick for its Warp kernel.
 *
 * The same law, steps and order of operations as the kernel: RK4 between events (samples and changes of the current), smaller
 * steps near standstill where there is friction, and D forward sensitivities carried along. Compile with -DD=3.
 */

#include <math.h>

#ifndef D
#define D 3
#endif

#define PARAMETERS 14 /* of which this law uses the first eleven */
#define TIME_EPS 1e-9

typedef struct {
    double inertia, ga, gb, gc, kt, fc, fv, fl, volt, emf, ohm, vs;
    const double *d_inertia, *d_ga, *d_gb, *d_gc, *d_kt, *d_fc, *d_fv, *d_fl;
} Law;

static double current(double command, double v, double volt, double emf, double ohm, double *slope)
{
    *slope = 0.0;
    if (volt > 0.0) {
        const double high = (volt - emf * v) / ohm;
        const double low = -(volt + emf * v) / ohm;
        if (command > 0.0 && command > high) {
            if (high > 0.0)
                *slope = -emf / ohm;
            return high > 0.0 ? high : 0.0;
        }
        if (command < 0.0 && command < low) {
            if (low < 0.0)
                *slope = -emf / ohm;
            return low < 0.0 ? low : 0.0;
        }
    }
    return command;
}

static double linearised(const Law *law, double q, double v, const double *dq, const double *dv, double command, double *da)
{
    double slope;
    const double i = current(command, v, law->volt, law->emf, law->ohm, &slope);
    const double motor = law->kt * i;
    const double side = tanh(v / law->vs);
    const double load = fabs(motor);
    const double c = cos(q), s = sin(q);
    const double inverse = 1.0 / law->inertia;
    const double friction = law->fc + law->fl * load;
    const double a = (motor - friction * side - law->fv * v - law->ga * c - law->gb * s - law->gc) * inverse;
    const double sign = motor < 0.0 ? -1.0 : 1.0;
    const double gain = 1.0 - law->fl * sign * side;
    const double by_q = law->ga * s - law->gb * c;
    const double by_v = gain * law->kt * slope - friction * (1.0 - side * side) / law->vs - law->fv;
    for (int n = 0; n < D; ++n) {
        double total = by_q * dq[n] + by_v * dv[n] + (gain * i) * law->d_kt[n];
        total = total - side * law->d_fc[n] - v * law->d_fv[n] - (load * side) * law->d_fl[n];
        total = total - c * law->d_ga[n] - s * law->d_gb[n] - law->d_gc[n] - a * law->d_inertia[n];
        da[n] = inverse * total;
    }
    return a;
}

/* One run, `worlds` guesses. p (worlds, 14) and dp (worlds, 14, D) as in joint.py; q and v (worlds, samples), dq (.., D). */
void joint_pass(int worlds, int samples, const double *sample_times, int segments, const double *input_times,
                const double *input_current, const double *constants, const double *p_in, const double *dp_in, double *q_out,
                double *v_out, double *dq_out)
{
    for (int w = 0; w < worlds; ++w) {
        const double *p = p_in + w * PARAMETERS;
        const double *dp = dp_in + w * PARAMETERS * D;
        const Law law = {p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], constants[0], constants[1], constants[2],
                         constants[3], dp, dp + D, dp + 2 * D, dp + 3 * D, dp + 4 * D, dp + 5 * D, dp + 6 * D, dp + 7 * D};
        const double delay = p[8], q0 = p[9], v0 = p[10];
        const double *d_delay = dp + 8 * D, *d_q0 = dp + 9 * D, *d_v0 = dp + 10 * D;
        const double coarse = constants[4], fine = constants[5], vs = constants[3];
        double q = q0, v = v0, t = 0.0, dq[D], dv[D], dt[D], d_end[D], dh[D];
        int segment = 0;
        double command = input_current[0];
        for (int n = 0; n < D; ++n) {
            dq[n] = d_q0[n];
            dv[n] = d_v0[n];
            dt[n] = 0.0;
        }
        for (int k = 0; k < samples; ++k) {
            const double goal = sample_times[k] - delay;
            double *row = dq_out + ((long)w * samples + k) * D;
            if (goal <= 0.0) {
                q_out[w * samples + k] = q0 + v0 * goal;
                v_out[w * samples + k] = v0;
                for (int n = 0; n < D; ++n)
                    row[n] = d_q0[n] + goal * d_v0[n] - v0 * d_delay[n];
                continue;
            }
            for (int arrived = 0; !arrived;) {
                double end = goal;
                int switches = 0;
                if (segment + 1 < segments && input_times[segment + 1] < goal) {
                    end = input_times[segment + 1];
                    switches = 1;
                }
                for (int n = 0; n < D; ++n)
                    d_end[n] = switches ? 0.0 : -d_delay[n];
                while (t < end) {
                    double da1[D], da2[D], da3[D], da4[D], dq2[D], dv2[D], dq3[D], dv3[D], dq4[D], dv4[D];
                    const double a1 = linearised(&law, q, v, dq, dv, command, da1);
                    double h = coarse;
                    if (fine < coarse && fabs(v) < 20.0 * vs + fabs(a1) * coarse)
                        h = fine;
                    int last = 0;
                    for (int n = 0; n < D; ++n)
                        dh[n] = 0.0;
                    if (t + h > end - TIME_EPS) {
                        h = end - t;
                        for (int n = 0; n < D; ++n)
                            dh[n] = d_end[n] - dt[n];
                        last = 1;
                    }
                    const double q2 = q + 0.5 * h * v, v2 = v + 0.5 * h * a1;
                    for (int n = 0; n < D; ++n) {
                        dq2[n] = dq[n] + (0.5 * h) * dv[n] + (0.5 * v) * dh[n];
                        dv2[n] = dv[n] + (0.5 * h) * da1[n] + (0.5 * a1) * dh[n];
                    }
                    const double a2 = linearised(&law, q2, v2, dq2, dv2, command, da2);
                    const double q3 = q + 0.5 * h * v2, v3 = v + 0.5 * h * a2;
                    for (int n = 0; n < D; ++n) {
                        dq3[n] = dq[n] + (0.5 * h) * dv2[n] + (0.5 * v2) * dh[n];
                        dv3[n] = dv[n] + (0.5 * h) * da2[n] + (0.5 * a2) * dh[n];
                    }
                    const double a3 = linearised(&law, q3, v3, dq3, dv3, command, da3);
                    const double q4 = q + h * v3, v4 = v + h * a3;
                    for (int n = 0; n < D; ++n) {
                        dq4[n] = dq[n] + h * dv3[n] + v3 * dh[n];
                        dv4[n] = dv[n] + h * da3[n] + a3 * dh[n];
                    }
                    const double a4 = linearised(&law, q4, v4, dq4, dv4, command, da4);
                    const double mean_v = (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0;
                    const double mean_a = (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0;
                    for (int n = 0; n < D; ++n) {
                        dq[n] = dq[n] + (h / 6.0) * (dv[n] + 2.0 * dv2[n] + 2.0 * dv3[n] + dv4[n]) + mean_v * dh[n];
                        dv[n] = dv[n] + (h / 6.0) * (da1[n] + 2.0 * da2[n] + 2.0 * da3[n] + da4[n]) + mean_a * dh[n];
                    }
                    q = q + h * mean_v;
                    v = v + h * mean_a;
                    t = t + h;
                    if (last) {
                        t = end;
                        for (int n = 0; n < D; ++n)
                            dt[n] = d_end[n];
                    }
                }
                if (switches) {
                    segment += 1;
                    command = input_current[segment];
                } else {
                    arrived = 1;
                }
            }
            q_out[w * samples + k] = q;
            v_out[w * samples + k] = v;
            for (int n = 0; n < D; ++n)
                row[n] = dq[n];
        }
    }
}
