// The loss of the flexible link's study, written by hand: the candidates of a vector side by side, the same modal step, exact
// dry friction at the end of a step, phi error and magnitude of the response accumulated on the way. Arguments: candidates,
// steps, modes, lines, repetitions, input file, output file. All numbers are float64; the file holds, one after the other,
//   torque [steps], phi [steps], omega^2 [lines], gain [lines], and for each candidate
//   a b c d bent pushed participation tip squares damping [modes each], inertia, borne, v, tau_c, L, h.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#ifdef __AVX512F__
constexpr int W = 8;
#else
constexpr int W = 4;
#endif
typedef double V __attribute__((vector_size(8 * W)));

static V root(V x) { for (int i = 0; i < W; i++) x[i] = std::sqrt(x[i]); return x; }

template <int modes> static int run(char** argv) {
  const int pop = atoi(argv[1]), steps = atoi(argv[2]), lines = atoi(argv[4]), repeats = atoi(argv[5]);
  const int fields = 10 * modes + 6, blocks = (pop + W - 1) / W;
  std::vector<double> data(2 * steps + 2 * lines + (size_t)pop * fields);
  FILE* in = fopen(argv[6], "rb");
  if (!in || fread(data.data(), 8, data.size(), in) != data.size()) return 1;
  fclose(in);
  const double *u = data.data(), *phi_data = u + steps, *w2 = phi_data + steps, *gain = w2 + lines, *own = gain + lines;
  std::vector<V> numbers((size_t)blocks * fields);
  for (int b = 0; b < blocks; b++)
    for (int f = 0; f < fields; f++)
      for (int i = 0; i < W; i++) numbers[(size_t)b * fields + f][i] = own[(size_t)std::min(pop - 1, b * W + i) * fields + f];
  double norm_phi = 0, norm_gain = 0;
  for (int k = 0; k < steps; k++) norm_phi += phi_data[k] * phi_data[k];
  for (int l = 0; l < lines; l++) norm_gain += gain[l] * gain[l];
  std::vector<V> loss(blocks);
  std::vector<double> seconds;
  for (int r = 0; r < repeats; r++) {
    auto began = std::chrono::steady_clock::now();
    for (int blk = 0; blk < blocks; blk++) {
      const V* n = &numbers[(size_t)blk * fields];
      const V *a = n, *b = a + modes, *c = b + modes, *d = c + modes, *bent = d + modes, *pushed = bent + modes, *G = pushed + modes,
              *tip = G + modes, *squares = tip + modes, *damping = squares + modes, *rest = damping + modes;
      const V inertia = rest[0], borne = rest[1], v = rest[2], tau_c = rest[3], L = rest[4], h = rest[5];
      const V effective = inertia - borne + h * v / 2, level = h * tau_c, easy = 1 / effective;
      V e[modes] = {}, z[modes] = {}, w = {}, phi = {}, error = {};
      for (int k = 0; k < steps; k++) {
        V miss = phi - phi_data[k];
        error += miss * miss;
        V e1[modes], z1[modes], moved = {};
        for (int i = 0; i < modes; i++) {
          e1[i] = a[i] * e[i] + b[i] * z[i];
          z1[i] = d[i] * z[i] - c[i] * e[i];
          moved += G[i] * (z1[i] - z[i]);
        }
        V push = (effective - h * v) * w + h * u[k] - moved;  // momentum at the hub's own velocity, friction still to come
        V cut = push > level ? push - level : (push < -level ? push + level : V{});
        V next = cut * easy, change = next - w;
        for (int i = 0; i < modes; i++) { e[i] = e1[i] - bent[i] * change; z[i] = z1[i] - pushed[i] * change; }
        phi += h / 2 * (w + next);
        w = next;
      }
      V off = {};
      for (int l = 0; l < lines; l++) {
        V jr = inertia, ji = {}, tr = L, ti = {};
        const double s = w2[l], omega = std::sqrt(s);
        for (int i = 0; i < modes; i++) {
          V p = squares[i] - s, q = omega * damping[i], scale = s * G[i] / (p * p + q * q), er = scale * p, ei = -scale * q;
          jr += G[i] * er; ji += G[i] * ei; tr += tip[i] * er; ti += tip[i] * ei;
        }
        V dr = -s * jr, di = -s * ji + omega * v;
        V size = s * root((tr * tr + ti * ti) / (dr * dr + di * di)) - gain[l];
        off += size * size;
      }
      loss[blk] = root(error / norm_phi) + root(off / norm_gain);
    }
    seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count());
  }
  std::sort(seconds.begin(), seconds.end());
  FILE* out = fopen(argv[7], "wb");
  for (int k = 0; k < pop; k++) fwrite(&loss[k / W][k % W], 8, 1, out);
  fclose(out);
  printf("%.9f\n", seconds[seconds.size() / 2]);
  return 0;
}

int main(int, char** argv) { return atoi(argv[3]) == 4 ? run<4>(argv) : atoi(argv[3]) == 8 ? run<8>(argv) : 1; }
