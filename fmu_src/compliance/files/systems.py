"""What every machine of a platform has: the shared libraries that are part of the operating system."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

# glibc kept some of itself in libraries of their own until 2.34.
_LINUX = re.compile(
    r"(lib(c|m|pthread|dl|rt|util)\.so\.6|lib(pthread|dl|rt|util)\.so\.\d|ld-linux[\w-]*\.so\.\d|libc\.musl-.*)\Z"
)
_MACOS = re.compile(r"/usr/lib/|/System/Library/")

# Documented libraries of desktop Windows 7 and later. Not among them: what a redistributable brings (vcruntime140, msvcp140,
# msvcr*, mfc140, vcomp140, d3dx*) or a server role.
_WINDOWS_NAMES = """
activeds adsldpc advapi32 advpack amstream apphelp asycfilt atl authz avicap32 avifil32 avrt bcrypt bcryptprimitives
bluetoothapis bthprops cabinet certcli cfgmgr32 clbcatq clusapi combase comctl32 comdlg32 comsvcs credui crypt32 cryptbase
cryptdll cryptnet cryptsp cryptui cryptxml cscapi d2d1 d3d10 d3d10_1 d3d11 d3d12 d3d8 d3d9 davclnt dbgcore dbgeng dbghelp
dciman32 dcomp ddraw devmgr devobj dhcpcsvc dhcpcsvc6 dinput dinput8 dnsapi dpapi dpnet drt dsound dsprop dsquery dsrole dssec
dsuiext dwmapi dwrite dxcore dxgi dxva2 eappcfg eappprxy efsadu es esent evr faultrep fltlib fontsub framedyn gdi32 gdi32full
gdiplus glu32 gpapi gpedit hid hlink httpapi icm32 icmui ieframe imagehlp imgutil imm32 inetcomm iphlpapi iscsidsc kerberos
kernel32 kernelbase ksuser ktmw32 linkinfo loadperf logoncli lpk lz32 magnification mapi32 mf mfplat mfplay mfreadwrite
mgmtapi mi mlang mmdevapi mpr mprapi msacm32 msasn1 mscms mscoree msctf msdelta msdmo msdrm msdtcprx msftedit mshtml msi
msimg32 mspatcha msports msrating msvcp_win msvcrt msvfw32 mswsock mtxdm ncrypt ndfapi netapi32 netutils newdev nlaapi
normaliz ntdll ntdsapi ntlanman odbc32 odbccp32 ole32 oleacc oleaut32 oledlg opengl32 p2p p2pgraph pdh pdhui powrprof prntvpt
profapi propsys psapi quartz query qwave rasapi32 rasdlg rasman resutils riched20 riched32 rpcns4 rpcrt4 rstrtmgr rtm rtutils
samcli samlib sas scarddlg schannel schedcli scrobj scrrun sechost secur32 security sensapi setupapi sfc sfc_os shcore shdocvw
shell32 shfolder shlwapi slc slcext slwga snmpapi spoolss srclient srvcli sspicli sti t2embed tapi32 tbs tdh traffic twinapi
txfw32 ucrtbase uiautomationcore url urlmon user32 userenv usp10 uxtheme vdmdbg version virtdisk vssapi wdsclientapi
webservices websocket wecapi wer wevtapi wiaservc win32u winbio windowscodecs windowscodecsext winhttp wininet winmm winscard
winspool winsta wintrust winusb wkscli wlanapi wlanui wldap32 wmi wow32 ws2_32 wsdapi wsnmp32 wsock32 wtsapi32 xinput9_1_0
xmllite xolehlp xpsprint
"""
_WINDOWS = frozenset(_WINDOWS_NAMES.split())
_WINDOWS_SETS = re.compile(r"(api|ext)-ms-win-[\w-]+\Z")  # names under which Windows offers its own libraries


def is_part_of(suffix: str, name: str) -> bool:
    """Does the system whose libraries end in `suffix` bring the library `name`, as a library names it that needs it?"""
    if suffix == ".so":
        return bool(_LINUX.match(name))
    if suffix == ".dylib":
        return bool(_MACOS.match(name))
    stem = name.lower().removesuffix(".dll").removesuffix(".drv")
    return stem in _WINDOWS or bool(_WINDOWS_SETS.match(stem))


def names_in(text: str) -> frozenset[str]:
    """The names of libraries that a text may mean: its words, in small letters, without suffix and version."""
    return frozenset(_stem(word.strip(".")) for word in re.findall(r"[\w.+-]+", text.lower()))


def is_named(library: str, names: frozenset[str]) -> bool:
    """Is the library among `names`?"""
    return _stem(PurePosixPath(library).name.lower()) in names


def _stem(name: str) -> str:
    """libfoo.so.1 and foo.dll: foo."""
    return re.sub(r"(\.\d+)*\.(so|dll|dylib)(\.\d+)*\Z", "", name).removeprefix("lib")
