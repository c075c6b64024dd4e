#include "iris/core/atomic_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <functional>

#include "iris/core/error.h"
#include "support/full_disk.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::StartsWith;

class AtomicFile : public ::testing::Test {
 protected:
  // Nothing but `names` lies in the folder: no temporary files.
  void expect_only(const std::vector<std::string>& names) const {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_.path())) found.push_back(entry.path().filename());
    EXPECT_THAT(found, ::testing::UnorderedElementsAreArray(names));
  }
  const testing::TemporaryFolder folder_;
  const fs::path path_ = folder_.path() / "a.txt";
};

std::string message_of(const std::function<void()>& body) {
  try {
    body();
  } catch (const InputError& error) {
    return error.what();
  }
  return "no InputError";
}

TEST_F(AtomicFile, BytesComeBackAndReplaceThoseBefore) {
  const std::string bytes("a\0b\r\n\xff", 6);
  write_file(path_, bytes);
  EXPECT_EQ(read_file(path_), bytes);
  write_file(path_, std::vector<unsigned char>{1, 0, 2});
  EXPECT_EQ(read_file(path_), std::string("\1\0\2", 3));
  const std::string large(300000, 'x');  // more than one block of the reader
  write_file(path_, large);
  EXPECT_EQ(read_file(path_), large);
  write_file(path_, std::string_view());
  EXPECT_EQ(read_file(path_), "");
  expect_only({"a.txt"});
}

TEST_F(AtomicFile, FoldersAreMade) {
  const fs::path deep = folder_.path() / "b" / "c" / "d.bin";
  write_file(deep, std::string_view("x"));
  EXPECT_EQ(read_file(deep), "x");
}

TEST_F(AtomicFile, AWriterGetsANeighbourWithTheSameExtension) {
  write_file_with(folder_.path() / "image.png", [&](const fs::path& temporary) {
    EXPECT_EQ(temporary.parent_path(), folder_.path());
    EXPECT_EQ(temporary.extension(), ".png");
    EXPECT_FALSE(fs::exists(folder_.path() / "image.png"));
    std::ofstream(temporary) << "pixels";
  });
  EXPECT_EQ(read_file(folder_.path() / "image.png"), "pixels");
  expect_only({"image.png"});
}

TEST_F(AtomicFile, AWriterThatThrowsLeavesWhatWasThere) {
  write_file(path_, std::string_view("before"));
  EXPECT_THROW(write_file_with(path_,
                               [](const fs::path& temporary) {
                                 std::ofstream(temporary) << "half";
                                 throw Interrupted();
                               }),
               Interrupted);
  EXPECT_EQ(read_file(path_), "before");
  expect_only({"a.txt"});
}

TEST_F(AtomicFile, AWriterThatWritesNothingIsAnError) {
  EXPECT_THROW(write_file_with(path_, [](const fs::path&) {}), InputError);
  expect_only({});
}

TEST_F(AtomicFile, AFullDiskIsAnErrorAndLeavesWhatWasThere) {
  write_file(path_, std::string_view("before"));
  std::string message;
  {
    const testing::FullDisk full(64 * 1024);
    message = message_of([&] { write_file(path_, std::string(1 << 20, 'x')); });
  }
  EXPECT_THAT(message, StartsWith(path_.string() + ": cannot be written"));
  EXPECT_THAT(message, HasSubstr("free some space"));
  EXPECT_EQ(read_file(path_), "before");
  expect_only({"a.txt"});
}

TEST_F(AtomicFile, PlacesThatCannotBeWrittenAreErrorsThatNameThem) {
  write_file(path_, std::string_view("a file, no folder"));
  EXPECT_THAT(message_of([&] { write_file(path_ / "b.txt", std::string_view("x")); }), HasSubstr(path_.string()));
  EXPECT_THAT(message_of([&] { write_file_with(path_ / "b.txt", [](const fs::path&) {}); }), HasSubstr(path_.string()));
  // A file system that makes no files, not even for root.
  EXPECT_THAT(message_of([] { write_file("/proc/iris.txt", std::string_view("x")); }), StartsWith("/proc/iris.txt: "));
  // The target is a folder.
  fs::create_directory(folder_.path() / "folder");
  EXPECT_THROW(write_file(folder_.path() / "folder", std::string_view("x")), InputError);
  expect_only({"a.txt", "folder"});
}

TEST_F(AtomicFile, WhatCannotBeReadIsAnErrorThatNamesIt) {
  EXPECT_THAT(message_of([&] { read_file(path_); }), StartsWith(path_.string() + ": cannot be read; check the name"));
  EXPECT_THAT(message_of([&] { read_file(folder_.path()); }), StartsWith(folder_.path().string() + ": cannot be read"));
}

}  // namespace
}  // namespace iris
