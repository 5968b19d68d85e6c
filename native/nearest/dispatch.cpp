// Which kernels this machine runs.
#include "nearest.h"

namespace nearest {

extern const Kernel kernel_plain;
#ifdef SGM_X86
extern const Kernel kernel_avx512, kernel_avx2;
#endif

const std::vector<Kernel>& kernels() {
  static const std::vector<Kernel> found = [] {
    std::vector<Kernel> list;
#ifdef SGM_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vnni")) {
      list.push_back(kernel_avx512);
    }
    if (avx2) list.push_back(kernel_avx2);
#endif
    list.push_back(kernel_plain);
    return list;
  }();
  return found;
}

}  // namespace nearest
