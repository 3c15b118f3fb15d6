#include "core/file_output.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>

#include "core/error.h"
#include "core/hash.h"
#include "tests/support/temporary_folder.h"

namespace sekitei {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

class FileOutput : public ::testing::Test {
protected:
    static std::vector<std::string> names_in(const fs::path& folder)
    {
        std::vector<std::string> names;
        for (const auto& entry : fs::directory_iterator(folder))
            names.push_back(entry.path().filename().string());
        return names;
    }

    TemporaryFolder temporary_;
    const fs::path folder_ = temporary_.path();
};

TEST_F(FileOutput, TheTargetIsTheOldFileUntilCommitAndTheNewOneAfterwards)
{
    const fs::path target = folder_ / "a.txt";
    write_file(target, "old");
    {
        AtomicFile file(target);
        file.write("new ");
        file.write(std::string(3 << 20, 'x'));
        EXPECT_EQ(read_file(target), "old");
        file.write_at(0, "NEW", 3);
        EXPECT_EQ(file.size(), 4u + (3u << 20));
        file.commit();
    }
    EXPECT_EQ(read_file(target), "NEW " + std::string(3 << 20, 'x'));
    EXPECT_THAT(names_in(folder_), ::testing::ElementsAre("a.txt"));
}

TEST_F(FileOutput, WithoutCommitNothingStays)
{
    const fs::path target = folder_ / "a.txt";
    write_file(target, "old");
    try {
        AtomicFile file(target);
        file.write(std::string(2 << 20, 'x'));
        EXPECT_THAT(names_in(folder_), ::testing::SizeIs(2));
        throw Cancelled();
    } catch (const Cancelled&) {
    }
    EXPECT_EQ(read_file(target), "old");
    EXPECT_THAT(names_in(folder_), ::testing::ElementsAre("a.txt"));
}

TEST_F(FileOutput, AVerifierThatThrowsKeepsTheOldFile)
{
    const fs::path target = folder_ / "a.txt";
    write_file(target, "old");
    AtomicFile file(target);
    file.write("new");
    file.set_verifier([&](const fs::path& temporary) {
        EXPECT_EQ(read_file(temporary), "new");
        throw IoError("refused");
    });
    EXPECT_THROW(file.commit(), IoError);
    EXPECT_EQ(read_file(target), "old");
}

TEST_F(FileOutput, AFullDiskNamesNeededAndFreeAndKeepsTheOldFile)
{
    const fs::path disk = folder_ / "disk";
    if (!temporary_.mount_small(disk, "64k"))
        GTEST_SKIP() << "mounting a file system is not permitted";
    write_file(disk / "a.bin", "old");
    const std::string big(5300000, 'x');
    auto reserved = [&] { write_file(disk / "a.bin", big); };
    EXPECT_THAT(reserved,
                ThrowsMessage<IoError>(AllOf(HasSubstr("a.bin: no space: needed 5.3 MB, free 6"),
                                             HasSubstr("cannot write"))));
    auto streamed = [&] {
        AtomicFile file(disk / "a.bin");
        for (int i = 0; i < 5300; ++i) file.write(big.data(), 1000);
        file.commit();
    };
    EXPECT_THAT(streamed, ThrowsMessage<IoError>(HasSubstr("no space: needed")));
    EXPECT_EQ(read_file(disk / "a.bin"), "old");
    EXPECT_THAT(names_in(disk), ::testing::ElementsAre("a.bin"));
}

TEST_F(FileOutput, AReadOnlyFolderIsRefusedBeforeAnythingIsWritten)
{
    const fs::path folder = folder_ / "fixed";
    if (geteuid() == 0) {
        if (!temporary_.mount_small(folder, "64k", MS_RDONLY))
            GTEST_SKIP() << "root may write everywhere and cannot mount here";
    } else {
        fs::create_directory(folder);
        fs::permissions(folder, fs::perms::owner_read | fs::perms::owner_exec);
    }
    EXPECT_THROW(check_target(folder / "a.txt"), IoError);
    EXPECT_THAT([&] { write_file(folder / "a.txt", "x"); },
                ThrowsMessage<IoError>(AllOf(HasSubstr("a.txt"), HasSubstr("fixed"))));
}

TEST_F(FileOutput, BadTargetsAreNamed)
{
    auto checking = [](const fs::path& p) { return [p] { check_target(p); }; };
    EXPECT_THAT(checking(folder_), ThrowsMessage<IoError>(HasSubstr("is a folder")));
    EXPECT_THAT(checking(folder_ / ""), ThrowsMessage<IoError>(HasSubstr("found a folder")));
    EXPECT_THAT(checking(folder_ / "none" / "a.txt"),
                ThrowsMessage<IoError>(HasSubstr("no such folder")));
    write_file(folder_ / "file", "x");
    EXPECT_THAT(checking(folder_ / "file" / "a.txt"),
                ThrowsMessage<IoError>(HasSubstr("expected a folder")));
    ASSERT_EQ(mkfifo((folder_ / "fifo").c_str(), 0600), 0);
    EXPECT_THAT(checking(folder_ / "fifo"), ThrowsMessage<IoError>(HasSubstr("pipe or device")));
    EXPECT_THAT(checking("/dev/full"), ThrowsMessage<IoError>(HasSubstr("pipe or device")));
    EXPECT_THAT(checking(folder_ / std::string(256, 'n')),
                ThrowsMessage<IoError>(HasSubstr("256 bytes")));
    check_target(folder_ / "good.txt");
}

TEST_F(FileOutput, LongAndNonAsciiNamesWork)
{
    std::string longest;
    while (longest.size() + 3 <= 251) longest += "苔";
    longest += std::string(251 - longest.size(), 'a') + ".txt";
    ASSERT_EQ(longest.size(), 255u);
    for (const std::string& name : {std::string("苔.txt"), longest, std::string(255, 'n')}) {
        write_file(folder_ / name, name);
        EXPECT_EQ(read_file(folder_ / name), name);
    }
    EXPECT_THAT(names_in(folder_), ::testing::SizeIs(3));
}

TEST_F(FileOutput, ASymbolicLinkStaysAndTheFileItPointsToIsReplaced)
{
    fs::create_directory(folder_ / "far");
    write_file(folder_ / "far" / "real.txt", "old");
    fs::create_symlink("far/real.txt", folder_ / "link");
    fs::create_symlink("far/later.txt", folder_ / "dangling");
    fs::create_symlink("circle", folder_ / "circle");
    write_file(folder_ / "link", "new");
    write_file(folder_ / "dangling", "made");
    EXPECT_TRUE(fs::is_symlink(folder_ / "link"));
    EXPECT_EQ(read_file(folder_ / "far" / "real.txt"), "new");
    EXPECT_EQ(read_file(folder_ / "far" / "later.txt"), "made");
    EXPECT_THROW(write_file(folder_ / "circle", "x"), IoError);
}

TEST_F(FileOutput, PermissionsFollowTheUmask)
{
    const mode_t before = umask(027);
    write_file(folder_ / "a.txt", "x");
    umask(before);
    struct stat info {};
    ASSERT_EQ(stat((folder_ / "a.txt").c_str(), &info), 0);
    EXPECT_EQ(info.st_mode & 0777, 0640u);
}

TEST_F(FileOutput, LeftoversOfKilledProcessesAreRemovedAndOthersKept)
{
    const pid_t child = fork();
    if (child == 0) {
        const AtomicFile file(folder_ / "dead.vdb");
        kill(getpid(), SIGKILL);
    }
    int status = 0;
    waitpid(child, &status, 0);
    std::ofstream(folder_ / ".hidden.tmp") << "mine";
    ASSERT_THAT(names_in(folder_), ::testing::SizeIs(2));
    {
        AtomicFile alive(folder_ / "alive.vdb");
        alive.write("living");
        remove_stale_temporaries(folder_);
        EXPECT_THAT(names_in(folder_), ::testing::SizeIs(2));
        alive.commit();
    }
    EXPECT_THAT(names_in(folder_), ::testing::UnorderedElementsAre(".hidden.tmp", "alive.vdb"));
    remove_stale_temporaries(folder_ / "no such folder");
}

TEST_F(FileOutput, TwoWritersOfOneFileDoNotMix)
{
    AtomicFile first(folder_ / "a.txt"), second(folder_ / "a.txt");
    first.write("first");
    second.write("second");
    first.commit();
    EXPECT_EQ(read_file(folder_ / "a.txt"), "first");
    second.commit();
    EXPECT_EQ(read_file(folder_ / "a.txt"), "second");
}

TEST_F(FileOutput, ReadingRefusesWhatIsNotAFileOfBoundedSize)
{
    write_file(folder_ / "ten", "0123456789");
    ASSERT_EQ(mkfifo((folder_ / "fifo").c_str(), 0600), 0);
    EXPECT_EQ(read_file(folder_ / "ten", 10), "0123456789");
    EXPECT_THAT([&] { read_file(folder_ / "ten", 9); },
                ThrowsMessage<InvalidInput>(HasSubstr("at most")));
    EXPECT_THAT([&] { read_file(folder_ / "none"); },
                ThrowsMessage<InvalidInput>(HasSubstr("no such file")));
    EXPECT_THAT([&] { read_file(folder_); }, ThrowsMessage<InvalidInput>(HasSubstr("is a folder")));
    EXPECT_THAT([&] { read_file(folder_ / "fifo"); },
                ThrowsMessage<InvalidInput>(HasSubstr("pipe or device")));
    EXPECT_EQ(file_hash(folder_ / "ten"), hash_hex("0123456789"));
}

}  // namespace
}  // namespace sekitei
