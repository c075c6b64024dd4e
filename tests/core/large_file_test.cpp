#include "iris/core/large_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/full_disk.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

namespace fs = std::filesystem;

TEST(LargeFile, PartsMakeOneFile) {
  const testing::TemporaryFolder folder;
  const std::string large(300000, 'x');
  write_file_in_parts(folder.path() / "deep" / "a.bin", [&](const auto& put) {
    put("one\n");
    put({});
    put(large);
  });
  EXPECT_EQ(read_file(folder.path() / "deep" / "a.bin"), "one\n" + large);
}

TEST(LargeFile, AWriterThatFailsHalfwayLeavesWhatWasThere) {
  const testing::TemporaryFolder folder;
  const fs::path path = folder.path() / "a.bin";
  write_file(path, std::string_view("before"));
  EXPECT_THROW(write_file_in_parts(path,
                                   [](const auto& put) {
                                     put("half");
                                     throw Interrupted();
                                   }),
               Interrupted);
  {
    const testing::FullDisk full(64 * 1024);
    EXPECT_THROW(write_file_in_parts(path,
                                     [](const auto& put) {
                                       for (int i = 0; i < 100; ++i) put(std::string(1000, 'x'));
                                     }),
                 InputError);
  }
  EXPECT_EQ(read_file(path), "before");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 1);
}

TEST(SpoolFile, BytesAreReadBackFromAnywhereAndTheFileHasNoName) {
  const testing::TemporaryFolder folder;
  SpoolFile spool(folder.path() / "made");
  EXPECT_EQ(spool.append("abc"), 0u);
  EXPECT_EQ(spool.append(std::string(100000, 'x')), 3u);
  EXPECT_EQ(spool.append("def"), 100003u);
  std::string bytes(5, ' ');
  spool.read(100001, bytes.data(), 5);
  EXPECT_EQ(bytes, "xxdef");
  spool.read(0, bytes.data(), 4);
  EXPECT_EQ(bytes, "abcxf");
  EXPECT_THROW(spool.read(100002, bytes.data(), 5), Bug);
  EXPECT_TRUE(fs::is_empty(folder.path() / "made"));
}

TEST(SpoolFile, AFullDiskAndAFolderThatCannotBeMadeAreErrorsThatNameIt) {
  const testing::TemporaryFolder folder;
  SpoolFile spool(folder.path());
  {
    const testing::FullDisk full(64 * 1024);
    EXPECT_THROW(spool.append(std::string(1 << 20, 'x')), InputError);
  }
  write_file(folder.path() / "file", std::string_view("a file, no folder"));
  EXPECT_THROW(SpoolFile(folder.path() / "file" / "folder"), InputError);
}

}  // namespace
}  // namespace iris
