"""Weights of the evidence, from 28 simulated tuning flights: `bench_terrain.py fit`."""

# term: usual value, and spread
TERMS: dict[str, tuple[float, float]] = {
    "rough 0.3 m": (-2.892, 1.268),
    "rough 1 m": (-1.915, 1.258),
    "above": (0.004104, 0.2269),
    "standing": (0.245, 1.05),
    "residual": (-2.216, 0.7867),
    "residual against the frame": (0.1541, 0.6872),
    "residual 2 m": (-2.155, 0.6865),
    "sigma": (0.09971, 1.366),
    "restless 2 m": (0.1543, 0.2879),
    "unsure": (0.2326, 0.3601),
    "refused 2 m": (0.3089, 0.3415),
    "texture": (-2.403, 0.7968),
    "texture against the frame": (0.2259, 0.8003),
    "plants": (-1.618, 2.435),
    "light 0 most": (0.01923, 0.0408),
    "light 0 least": (-0.02024, 0.04236),
    "light 0 near": (-3.511, 0.7566),
    "light 0 near against the frame": (0.19, 0.7423),
    "light 0 wide": (-3.4, 0.5959),
    "light 0 wide against the frame": (0.1111, 0.5154),
    "light 1": (-0.001399, 0.05492),
    "light 1 near": (-3.288, 0.8049),
    "light 1 near against the frame": (0.1995, 0.7997),
    "light 1 wide": (-3.155, 0.6217),
    "light 1 wide against the frame": (0.1163, 0.5531),
    "light 2": (-0.003914, 0.06861),
    "light 2 near": (-3.187, 0.8398),
    "light 2 near against the frame": (0.211, 0.8416),
    "light 2 wide": (-3.033, 0.6489),
    "light 2 wide against the frame": (0.1281, 0.5951),
    "light 3": (-0.008329, 0.0819),
    "light 3 near": (-3.107, 0.8634),
    "light 3 near against the frame": (0.1982, 0.8535),
    "light 3 wide": (-2.936, 0.6785),
    "light 3 wide against the frame": (0.143, 0.6296),
    "light local": (-0.01293, 0.1556),
    "light broad": (-0.03067, 0.1817),
    "darkest near": (0.3001, 0.2859),
    "darkest near against the frame": (0.09862, 0.2809),
    "brightest near": (0.2305, 0.2053),
    "brightest near against the frame": (0.04917, 0.1773),
    "red 0 most": (0.003942, 0.008917),
    "red 0 least": (-0.004001, 0.009133),
    "red 0 near": (-4.779, 0.5429),
    "red 0 near against the frame": (0.1477, 0.477),
    "red 0 wide": (-4.704, 0.4975),
    "red 0 wide against the frame": (0.09094, 0.3928),
    "red 1": (3.337e-06, 0.01191),
    "red 2": (8.54e-05, 0.01628),
    "red 2 near": (-4.536, 0.7457),
    "red 2 near against the frame": (0.1746, 0.6779),
    "red 2 wide": (-4.404, 0.6706),
    "red 2 wide against the frame": (0.1161, 0.5423),
    "red 3": (0.0001745, 0.02111),
    "red local": (1.421e-05, 0.03756),
    "red broad": (-0.0009447, 0.04754),
    "blue 0 most": (0.007132, 0.01694),
    "blue 0 least": (-0.007098, 0.01686),
    "blue 0 near": (-4.401, 0.7159),
    "blue 0 near against the frame": (0.2102, 0.661),
    "blue 0 wide": (-4.294, 0.611),
    "blue 0 wide against the frame": (0.1323, 0.5097),
    "blue 1": (0.0002008, 0.02193),
    "blue 2": (0.0008763, 0.02807),
    "blue 2 near": (-4.124, 0.892),
    "blue 2 near against the frame": (0.2546, 0.8493),
    "blue 2 wide": (-3.96, 0.7483),
    "blue 2 wide against the frame": (0.1642, 0.6524),
    "blue 3": (0.001364, 0.03381),
    "blue local": (0.001576, 0.06573),
    "blue broad": (-0.001389, 0.07616),
    "height 0": (0.01455, 1.018),
    "height 1": (0.03179, 1.14),
    "height 2": (0.0827, 1.465),
    "height 3": (0.2045, 1.735),
    "height local": (0.2073, 2.045),
    "height broad": (0.8383, 2.644),
    "highest near": (1.631, 1.863),
    "highest near against the frame": (0.4532, 1.801),
    "lowest near": (1.34, 1.864),
    "lowest near against the frame": (0.03098, 1.803),
    "steep": (-1.602, 1.216),
    "residual spot": (0.009236, 0.08793),
    "ambiguous": (0.06097, 0.2092),
    "restless": (0.1536, 0.3384),
    "step": (0.1196, 0.2866),
    "saturated": (0.04093, 0.1765),
    "textureless": (0.05338, 0.1845),
}

# of each layer: inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats
LAYERS: tuple[tuple[int, int, str], ...] = (
    (
        88,
        24,
        "2p~eRL@-DkVl9BA1uoR94lco~@3BRyp|AukvM7WjiK#>;IIf$py($>8#H7V5Rx?DdfiMLqj<Zg)O`&utu&!P-DKGylfw5$+`>cH}uAWw"
        "@YBUV7z_0_Uh_X$r;jSnowKD-P@~s%H2d`!<|EUo&Ixd{Avn2$c1F-6<(WXbTEiC3L2d_XdXsszM5)=cpt10obTBrb}uBvq;v@q_nR;?"
        "8>*Rd)u=Osrhn6V)()G#Tl*R5qSth7QX4l)}yKdXbYjItB1lqtikbtlcRy((9+_O(?sRT-=;A~Fi3?5$<5;4ZB)*0eY@Ni4Cl1vW0TG_"
        "hx~8n|gStu5D+q%QKQ*)=h!?KI@FBqJv+P8=yPB{c3V7OGaV$ux;40Wu4)Z?eiFi>+_1XfbpxwJ*K1H@9`KV6Yr8rZ+>X<T4Djw5~_7^"
        "0YlRhA~MfMj5QCMyv;|QXgNVtg~0I>ZiM?E-~w_YO>xb-Yk@_#VoEbb157#)h2;2i7xfAn<>k$m#Lt$TQ0q>0I!*&)2gJZp{e1pzpxZ7"
        "ax=29nygB!W3L6SyetVcN;Batt0~Sc%CEg4q^y9Y<(4rmG%W10@*Z3zL9!31P%!x|0x|6wKdv>cFfD+urZXnAk~GM$c&rL7fhS|EH7YM"
        "Oy{1Dj(X!19C^2Z9&@<JGCp5&c_poC#r?!eL9xj$6H>>WbH>{j80j`EBHZ*6N+%Y{aA*a4G#j!-K0j*`FvZZk}O(k%#!YL1{*%??X9jX"
        "Vdr!NaH5iJTdfi6NU)htUZEU~PwXry<wva%1S04d$H+p0`2PqY9pqbd5Xtt6N(&Z-WoX)Zjq*C|jfEVL#Z`KvD?^fI9`V==0-gC&EqrZ"
        "oMYJ}Zu|@vUAZ613AW;i?g>79}>Sz^$t(12G3M(JXBuaH@7IEGojVk*ZB2As~A!jj9ruJ1ik2a4rC_iXiVST`X!VaE)Lirl?P^L5t8Ue"
        "xXRMuBJ&bZzPngqNW8Yz$9m)Qna)p+p)ehr?dC561F)lFtRlr%P=T2#51y}yQ8EtRW<6an5cF%04;*ELM(5ovapsjVy5k`>!%>Jo-*gH"
        "9ILn=KC4(V+$qzoOETrNyQOlm$FF3y5Hcn)h_TTxU9sIU;<2zYK(rOL&9PCgMYM*p8ZneIcq*+f8n4hZb~O92O|d^SJTa`UNiET+HLlI"
        "7el%=0*)GkokSs1KQ8a+9TCrs>DKHZ#m@av+IWaM-Pywf^k~G}3f3%XSa3ajB1}2a!a36rJQ=RXqfFPQkl&9w*vZ&LmI4OFpZY|cR8Y1"
        "x@*C3^=X{U&wG9DhZb|!Z*Rj?Kv6t(iI@2ny(dN5WnwlR(_Td))=T`^;^G^_G4*&6+@CoO!a*eP8z-l@~GlC2u74m38bx*YeZ4k)WIC8"
        "s;EZ!0UZP_iJdW+e-<WHA&i$E%m4q%8EZG_a5_O|^-%nxuoLQn2@-wKVlH8>sU#<SVl@A2Ix~8L3}4JSJ<crzHw5qpi^}&@q!R+^?b}U"
        "7|}X9;sd_q$6=N2rI9yDXhP(R<S3sy&(6fnlMZ=+^lOXhnz;ByDXt0Rjeu-9<UXoZ!9CE+pdS3v?m=gU#t3_<Eelwh9&$h6D%34J*bqd"
        "Y$%wtgdRe&O0rfl0J5+v@GoSl+$~Kppe}ealQBuGH!Dst&aUC8@~GLcAg~Oj-jx9{JE$`(jWM<nJu(}pA)ciwV6oh&=dN9`)Ewk7nW_k"
        "{lQFll$Sy`KGApk#|15R55HFRk{;g3eJG4idk~P~bd@#l=v9R4V%BSlv%`2}i9IC}Mkg-3tr>I=9wWtd-Au8XYM5<{ZvoL(9nkGUpST$"
        "@RTdi@e=qf^()U-sbc`b{x8Zo#vjjb0kI4xl>@UZEwX{B$gh^*En#GnDP>82v5_njlI7BOqAY_ag2R-ZgDXr|jPFf^nrPbbr}6R`TKv8"
        "u%?up~Vvk1csFA23WUQm1?{o+Mf-4<>jpQzMBosIV=pxvK%PC#QTc&n+t^eyV4ziYDZvtFvOEgt4rwlCBD}*{X;zNG?{baWH3`eJCv{^"
        "o*P{BsHtABel>eqpKAiI4FX$imUo6l`XlPIi$ulzM*<3M6Uv{6EiX=ZL+E?W~>k@x-dg5Kr5apv@*dlrz486w=W$ot+B?iz_7j`Z!J}`"
        "NwbM8dNmrc%CP&Wb+Jh>Z;@UmKBmyC#w?*MQ7iB&d>m%5gstBhMX1i8!ZBYi7Otc*(=ZY&+l4DH#WZd+RkswUH>#PhlPDOl%rc5NbT9O"
        "=B)51m#<D=PXfSQD4Y&j{-Lxk#B$?nZO*FbU3ok9M3$<V^->V?4)~GMBaHrcS8MD?gR5P$P7N>JHnzU~%hpFo<Tr;1m)Gd6pn6b$)S1g"
        "RQN3>S2JuSQ`Ff#irw69t$5VH_4>zTZ*qqMLw0<l-5ZJ8A-gR77*exdBNLnw1FMKK;T*fBGw%cIY-#I9*BnlnWxvMuW}^e&DeMzP*C3>"
        "%xVnJt~LNh=Ai`7E8ZKe0|N2s8sQvN3V6im)Ry&$Gv_Wg&jFHmv0?t*~A)<E;Cwy0YITdL&n*wX7;F@TBssCz_flv6NgYey;tY|D_nK)"
        "}~4&g(BXrXDU#hv#r)6>8ckNYNZ0M;4lNKuPyN|BqhD505HX<$1h%_8>k#Cc&q*oKB|f_1dszQFe;I&NG^Y`{x9*c6R9;XF0R_JPcCvU"
        ";St&{O{_yJ4y_U^YcZ@XP^^cpJFx7snX-YbsW4}>94lNekr(x?gCG*MB(1GA{wTdH;x&@7wV?JY>LdKIyr@j3E*Ph*yryTdBdcnxtTKz"
        "SA)aqB^sw%&;3)$n2(6DQI<i+Xy{;EB#3w^3g0%XuN&uj(Ca~QrrXUEncQX*LnKP#>=`As~L?4?i(5?O~BCxS6J*^C_F|$9e?Jc^i#UN"
        "F#St{463ZcBP(5bp4Ss)Ux+o}|<Wi1`9xu{(#J+VfuBdKv9Fe-W;)Ghj_^Ak(0*)5nY`Y8S?I3&EG7_IlN(V=55*{hH*z9bMNNH7tj@2"
        "HBW*C`^cCZ^RV=Aq-R&nXfc)uouC_%Na*i>z8L(Wj}c{3@@jq_Ji%SFt8B!m6ey?K5mJEv@&l@0wAtO02>%bSW#MpC{!pGb~)90jLGF7"
        "pxgFx~e)K=rkChC@}0PI<^%t(KA1!i?4JnZmq<xP%^_WKs0}>4lClM^RhlA&!Aha1SeW5Rj`FJ2NfnYYBR2}jj%SfTO3KThpsa)L8{lY"
        "f+O%HGc=hd+ceLo4<)rQQ!s5UXdio@{;E$g+_UJaLb7ojzO4B$h%X<hKq{4~z%V<oA}*gT-ztP6^{O*3h_K77!zR?M`X)83sikr#?k|9"
        "^$|wn~;Vq;nQKaV}eJuwr$E&F>X((+mJ*ZbLqN>0lqc8w0buPv*wyfZpVkecUHZ1b6@vR~%d9a=<rL+Stjxk&?lP@N)Tdqkm0l2=Y;;c"
        "5W4KN=p9kUp);3}B2+%nL#UanHA1}#mnTq!Iup|xbDm#inS&K%hv@3K>>7A*}dYpymPYp@|F_^Sl4KBlgy7oo*5$fbuX%c>QnpftZK@~"
        "2-grK%9AYA-o0{+v%9nIW$!f-h$*DJSA8lO{<I5h}p2v!5xi^)D_eueJ%Q6}92DBrmA1<+lv7!ng;g4yp{W<+Nun?Jxx(i?13k?W+kXi"
        "ZvrJhNYk}7_^YI&7_2~Y^^;sAg<e`tt)~g=P*z(z_Sjv38ED=aiK)1b0`L+fiB6d<uk}Bvb91qb+CsiYqJ%yyRiMV;JK<Sq@24V?y$o$"
        "N;N>N%`h3P3mQPQT`z?w;4`8$+_0pxt1lxk+q640Q7jd;l(1?qTQub>47WeB%Q9y*f-yL*rY04!PP3J(JtQn8FD<?-4={cy&M)ODGbR6"
        "^n<|Z`k}O{?uPqL+bPg;m&6wD$)}+TMMx?f@N~w&lGogep+M|Uf)UaBo`7SLe`KVK*#HaNtoPfF<Yb~fP6|lW3r7Re!*Cetm=q;eNrmU"
        "x}T&mcttu9b4%`G~lxwtN^@vfAp@Gx{K@tKD(5+&|2+boo`b~3B6#jR*DJFVulH!Y5(Br(V_Zlx8ip)vd!04e||H>vHjpt6!RqpZIzpD"
        "=(hPbSQu`YnyK_N?qNc`kAS$tZ0v{w@ctgSRLvf~9&e2sPxcyR0p;<u6w%IIC>3EiC`6gs2oQimdjtjV1xEfi(Cr;;(bBxGk%wE+>Sun"
        "X$(ycCMlzu_}Zx^{6p4Atq2XhbOKtL$uAYMzEbGBQYwj4WLXaj2~nx+b}k=0j({toU8yXyRg49v#(+>k|<O%gEO?U5HKaNxv8KsDK53G"
        "pdj=v)391CoGaY2$1LhF(W(kEld)(rZ7wjh05Sb3>a208A}>d@qo%JleJ@C=UmpQA%{Du(LM}-#lO++aQmjEQKePZfKDCUurLO}wt)i%"
        "+F{mOc@u>kPKd4b0-=sb#`=bsa;HCbeEwE>xRHsxO;iZ8jb)(^)`lzxaDII~Thnq>O6)c({>?j_m6{+{6&n|zQO{^3luq@%GXC#a%->S"
        "r{w5ob7%PdBv{-`oAC9GI1W2yzM0GrXR#IUq1vMSoBPBL>L7#_nhGbv@T6e1HYX{w4VlBCb4pDExiTr3r&nI(fId8bP#38q9a$t|idJF"
        "tkWe=#Akbu2(0Jt_4rD5a7hrl_SRf15wB8!!bZ&@nq8p)c_+(kv^ko3AG;`LFG$-y|&~wV;!&Tpe>Tr6>!pK8_G56)a7pZ7>BeR57EYP"
        "MZm&)+)+0ny$byV<b8%fiI}1q$jnfpfK$xZL1eAH!VD)ODjhrx~kx+ejK5!U@*wArLz66wx1%dwJmk5pQ^zuZ!y`fF0A`7z%Pj^x-1ql"
        "X{J!CxhK9Ya;rZpZLxMUN;GjShOT!i94^!(K&tDoZLu9OeyyF9FD>z~fvmc;Of9vmI4hH|oiF{bI52LrNTvz1owBm5Q>$DoGbrvbI4!5"
        "C@vX-jKrrB~Gcb5CL#)25J|uoCTBHmxPqdOVfH5K~F){ikkt}f<B`ANfKC6)}{haYC2q`<Nm#ZYR`k**4j;|c6bG3=IuP*#3N3#Vmey3"
        "e76tRA>Dy)Dm^s-K|PbA|c!m~&=XsIzVTrX*<QLIfYo2_iIkS>WQ1~4+Jtfw2WF(eWzQ7y$IIjp;`hN(rYSg!f2aI%A}tur?*R;@;?cC"
        "3A`CoDxOxh?aq#;%2|wXBV=R;h8YLM7TQ2CAv32Pu^-YpW(CKd<?)#5A-pyd^XsmMzsB{wHoMb)^cgOC~-c=`4w&9<9)#TdWByoT%?FE"
        "0`KC>#2OK%&efH%Cq;ToS~^MZn8!%Dlhgh!k^@<WT~C0O0h{SL@bk=7__r47pt8a&8wHJ>8hQrp|A`wQZLyq5VF;?v7GxUQLGOv?l8&~"
        "6f9dbw5*UU?x#yByeSMYdoWWoUbZSN3AA-EO)zgUQLrkitgRrTnIMU;3ayi<Z?NhmjWc&71FY~U_N>6EK)aba%rdez5j#Pi8m|aB-83q"
        "*A~QX-5Hwvorz+h#syY=gnyxaiCNx&Je>xF0",
    ),
    (
        24,
        8,
        "zcRQoOtq>xb-Io%l(m(x6fw~>3Oft5*0?!0^|sQuEwWvz#Iz^4fH&#5&^fC&y*4v9U^uU|=eKdS?YMI_K`_-i)VMUU?zA_uWi=zX$u?T"
        "GRkn&U3be(xPCJOLGd85QTD8n4H?rnBYPJt7si>wcCN3|y9I@HBD>jBYGPPeefwFtFPpBTaYB)4FXSF}E<16$rqO)qYNUXv-Wi<1-*t@"
        "o(!L&X*t2F5~g0=au60warue89kBrwA@7dl0;nlDQ?{jy&#P_;X^x;OW&LO1fXX0|rAWj9>6v$?J|c`<afGpMPx$u|}<QZ0))RyR(ruP"
        "@FrIJ(8Ru(IN}$Tl`NaXX+XK)Eim$DUraQZ$0J6|{P?g*(5lCATjvcd$4)$F&eG+q0B57N-NbG&5+lhPFXDpSJ}$ueUETra9fJqOKz~*"
        "Rd3|@;NHE?X6g*uCr+^Z@J|-3N!*WGq~icjkM4?F1FCLEjlE!M683d);Pl|iM9{8P%z3k^sHyO*)EndDJ?U$",
    ),
)
