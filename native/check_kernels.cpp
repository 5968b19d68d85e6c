// Every kernel of this machine against the plain one, bit by bit, on random pairs. For machines without our Python
// environment: native/arm64.sh runs it under an emulator. Exit code 1 where a bit differs.
#include "sgm/match.h"
#include <algorithm>
#include <cstdio>
#include <cstring>
#include <random>

namespace {

struct Pair {
  int width, height, right_width;
  std::vector<sgm::u8> left, right;
};

Pair random_pair(std::mt19937& random, int width, int height, int wider) {
  Pair p{width, height, width + wider, {}, {}};
  p.right.resize(static_cast<std::size_t>(p.right_width) * height);
  p.left.resize(static_cast<std::size_t>(width) * height);
  for (auto& v : p.right) v = static_cast<sgm::u8>(random());
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {  // a slanted surface, with noise
      const int at = std::min(p.right_width - 1, x + wider / 2 + y / 9 % 5);
      p.left[y * width + x] = static_cast<sgm::u8>(p.right[y * p.right_width + at] + random() % 7);
    }
  }
  return p;
}

std::vector<float> run(const Pair& p, const sgm::Ranges& ranges, sgm::Options options, const char* kernel,
                       std::vector<sgm::u16>& score) {
  sgm::Workspace workspace;
  std::vector<float> found(p.left.size());
  score.assign(p.left.size(), 0);
  options.kernel = kernel;
  sgm::match({p.left.data(), p.width, p.height}, {p.right.data(), p.right_width, p.height}, ranges, nullptr, options,
             workspace, found.data(), score.data());
  return found;
}

bool same(const Pair& p, const sgm::Ranges& ranges, const sgm::Options& options, const char* kernel) {
  std::vector<sgm::u16> score, plain_score;
  const std::vector<float> found = run(p, ranges, options, kernel, score);
  const std::vector<float> plain = run(p, ranges, options, "plain", plain_score);
  return score == plain_score && std::memcmp(found.data(), plain.data(), found.size() * sizeof(float)) == 0;
}

int check(const char* kernel) {
  std::mt19937 random(1);
  int wrong = 0, cases = 0;
  for (int round = 0; round < 40; ++round) {
    const int width = 1 + random() % 90, height = 1 + random() % 40, count = 1 + random() % 90;
    const Pair p = random_pair(random, width, height, count);
    sgm::Options options;
    options.threads = 1 + random() % 3;
    options.parabola = round % 2;
    options.uniqueness = round % 3 ? 0 : 5;
    for (int k = 0; k < 16; ++k) options.large_by_step.push_back(120 - 5 * k);
    sgm::Ranges dense;
    dense.low = -count, dense.count = count;
    std::vector<sgm::i16> first(p.left.size());
    std::vector<sgm::u8> blocks(p.left.size());
    for (std::size_t i = 0; i < first.size(); ++i) {
      first[i] = static_cast<sgm::i16>(-count + static_cast<int>(random() % (count + 20)) - 10);
      blocks[i] = static_cast<sgm::u8>(1 + (random() % 5 == 0) + (random() % 9 == 0));
    }
    sgm::Ranges ragged;
    ragged.first = first.data(), ragged.blocks = blocks.data();
    wrong += !same(p, dense, options, kernel) + !same(p, ragged, options, kernel);
    cases += 2;
  }
  std::printf("%s: %d of %d cases differ from plain\n", kernel, wrong, cases);
  return wrong;
}

}  // namespace

int main() {
  int number, wrong = 0;
  const sgm::Kernel* list = sgm::kernels(&number);
  for (int k = 0; k < number; ++k) wrong += check(list[k].name);
  return wrong ? 1 : 0;
}
