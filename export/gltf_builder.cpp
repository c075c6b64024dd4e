#include "export/gltf_builder.h"

#include <cerrno>
#include <fstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::exporters {

void write_glb(const std::filesystem::path& glb, const tinygltf::Model& model) {
  write_file_with(glb, [&](const std::filesystem::path& temporary) {
    // Not WriteGltfSceneToFile: it reports success when the disk is full.
    std::ofstream file(temporary, std::ios::binary);
    errno = 0;
    const bool made = file && tinygltf::TinyGLTF().WriteGltfSceneToStream(&model, file, false, true);
    file.close();
    if (!made || !file) {
      throw InputError(glb, std::string("cannot be written (") + std::strerror(errno) + ")",
                       "check the folder, its permissions and the free space");
    }
  });
}

}  // namespace iris::exporters
