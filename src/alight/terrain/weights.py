"""Weights of the evidence, from 100 simulated tuning flights: `bench_terrain.py fit`."""

# term: usual value, and spread
TERMS: dict[str, tuple[float, float]] = {
    "rough 0.3 m": (-2.902, 1.191),
    "rough 1 m": (-1.98, 1.178),
    "above": (-0.007947, 0.19),
    "standing": (0.2591, 1.052),
    "residual": (-2.336, 0.75),
    "residual against the frame": (0.163, 0.661),
    "residual 2 m": (-2.275, 0.6393),
    "sigma": (-0.04491, 1.316),
    "restless 2 m": (0.1445, 0.27),
    "unsure": (0.2931, 0.3796),
    "refused 2 m": (0.3363, 0.3406),
    "texture": (-2.371, 0.8074),
    "texture against the frame": (0.1789, 0.7478),
    "plants": (-1.708, 2.369),
    "light 0 most": (0.01943, 0.04209),
    "light 0 least": (-0.01991, 0.04258),
    "light 0 near": (-3.513, 0.779),
    "light 0 near against the frame": (0.1451, 0.6936),
    "light 0 wide": (-3.419, 0.6499),
    "light 0 wide against the frame": (0.09065, 0.5021),
    "light 1": (-0.0005723, 0.05572),
    "light 1 near": (-3.273, 0.8265),
    "light 1 near against the frame": (0.1508, 0.7451),
    "light 1 wide": (-3.159, 0.6785),
    "light 1 wide against the frame": (0.09191, 0.5354),
    "light 2": (-0.001981, 0.0674),
    "light 2 near": (-3.181, 0.8512),
    "light 2 near against the frame": (0.1672, 0.7807),
    "light 2 wide": (-3.046, 0.6933),
    "light 2 wide against the frame": (0.104, 0.5632),
    "light 3": (-0.005218, 0.07681),
    "light 3 near": (-3.119, 0.8643),
    "light 3 near against the frame": (0.1623, 0.7984),
    "light 3 wide": (-2.961, 0.7035),
    "light 3 wide against the frame": (0.1116, 0.5814),
    "light local": (-0.008203, 0.1515),
    "light broad": (-0.02141, 0.1612),
    "darkest near": (0.3179, 0.277),
    "darkest near against the frame": (0.08433, 0.2599),
    "brightest near": (0.255, 0.2171),
    "brightest near against the frame": (0.04729, 0.1774),
    "red 0 most": (0.00384, 0.00904),
    "red 0 least": (-0.003865, 0.009057),
    "red 0 near": (-4.797, 0.5412),
    "red 0 near against the frame": (0.1445, 0.4671),
    "red 0 wide": (-4.729, 0.4972),
    "red 0 wide against the frame": (0.08797, 0.3831),
    "red 1": (3.299e-05, 0.01206),
    "red 2": (8.246e-05, 0.01619),
    "red 2 near": (-4.571, 0.7457),
    "red 2 near against the frame": (0.1908, 0.6812),
    "red 2 wide": (-4.442, 0.6689),
    "red 2 wide against the frame": (0.1086, 0.5368),
    "red 3": (4.144e-06, 0.02092),
    "red local": (6.917e-05, 0.03909),
    "red broad": (-0.00109, 0.04822),
    "blue 0 most": (0.007044, 0.01738),
    "blue 0 least": (-0.006848, 0.0172),
    "blue 0 near": (-4.423, 0.731),
    "blue 0 near against the frame": (0.2002, 0.6471),
    "blue 0 wide": (-4.328, 0.6426),
    "blue 0 wide against the frame": (0.1204, 0.5107),
    "blue 1": (0.0003398, 0.02291),
    "blue 2": (0.0008912, 0.02914),
    "blue 2 near": (-4.15, 0.9131),
    "blue 2 near against the frame": (0.2556, 0.8491),
    "blue 2 wide": (-3.994, 0.7809),
    "blue 2 wide against the frame": (0.1497, 0.6547),
    "blue 3": (0.0009315, 0.03438),
    "blue local": (0.001658, 0.06813),
    "blue broad": (-0.002928, 0.07365),
    "height 0": (0.0147, 0.9037),
    "height 1": (0.03361, 1.019),
    "height 2": (0.09115, 1.337),
    "height 3": (0.2103, 1.607),
    "height local": (0.2459, 1.98),
    "height broad": (0.8575, 2.54),
    "highest near": (1.67, 1.804),
    "highest near against the frame": (0.4613, 1.769),
    "lowest near": (1.378, 1.785),
    "lowest near against the frame": (0.008185, 1.731),
    "steep": (-1.692, 1.195),
    "residual spot": (0.009486, 0.08517),
    "ambiguous": (0.04332, 0.1752),
    "restless": (0.1437, 0.3252),
    "step": (0.1021, 0.2598),
    "saturated": (0.03412, 0.163),
    "textureless": (0.05029, 0.1765),
}

# of each layer: inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats
LAYERS: tuple[tuple[int, int, str], ...] = (
    (
        88,
        48,
        "IjVrKt1z%HJ+v1u+@?Y*kEwX6qph?pVlfG+7pVcRYAnaG>#*e@udEI$?J+?v!KSMw->g_Iz^@6j%B4lHqOVaZ_bDf=nJy_P7A_pFXr&1"
        ")k0#KnHY6ypz@X=;(;i^6Bd<ELBQsVVz^)Oiax4}zJg`cubSAy2urFS#U9VZRVzi(o8?4x|Po9FWn=4#22(aNLk|M^ncPSh-uqfcKbSp"
        "5g6sadJBPO>ifhbQj8>w-wf+U=*@~$E)=B*{Ly09fI3MLz^Oe^Os4l8Rg2`SvKGcv;=*&(T_OtOHf8m=cXM=X0PholLyTPPYGda0r-i>"
        "Uas_9P9lDKZ5teJg1)QKfCCH!Kq>fG^XnRU_Ch@T6y?Z5=PJ@hcy&EiV?aC^KB32`U*cPpeQVTe7<@f~;LEqOf1E)FQm2_N~mUW-bP<t"
        "t%*?OfJwYf2lmNcAZ_ETBWBkzcMN?a<lZH618zLVWk8veX%tziz0NW)HN-#Jf=0Us;G3Z-K+qv_^9<Y%B?yug|nch<(}9hX|E705U+wU"
        "6|{`4pC^blb1Sv5m9Nt-+$u0IS}wvfAh1=W<gAS_^0QT?@fO0a#H=_l!?6OW87Xw5F({WZ7Pfh>PbMxf$1!oToGFbdbgq!O<}pK{tTqx"
        "ZVKs^`jI42|_BO&WbF+Okxhb+Qn4>wcr>_nfvnkgz-75a9>aBb-VJ}%NQaK40q%Gm8voF%Dj;&T9_NTG18!cg{8?Zt!H7F&m-mc=bmMd"
        "MTv@n4*i>B!$p0voSw5%ns%dJPO7P8K+1*{*n;x6(q`L2DdU#T1}I;Zk9`zQlAJg9>k)Tuu<NVs#V>@d5j;H@FARH{X>oFkhrfUJ=&5V"
        "MA}5~^r4L#$w|mY;~Ll&lP{O0H(Bz9v^He66u4SgDq*%CJ%-Tq?~htgOYNs->4MNGNWkwi_uhPaL)_-K$Elu_E^<aH-^^GccekD==*=;"
        "VZeN2_&kmc`LS|7N>NnFp`_1f-N(&*)KdTX(2r{bFs@T0VHFm3$a|NGcBT}TCEweqO4i5{I2Pxk1#f@n6cz4mb2_HSg>L>GO#Epe6TX8"
        "AuVnz>?^q%XPG9dP_hv)n;7RLH6`M&4y+`t(JI_A)T^X1cBr<iWH8gE86={v_pdP_?yQa^K`&CPysXiy2dmjJ*DCm^JEkrw*r*9ADX&>"
        "6j4T?SIvRtl7_3My`mDvR;wku}`lUH6dLF<lf+K>l$fOA;sVB-Zys9xRDJ5^L;HPV@3N;Ti!!E-yX0(4UH7Gi!fg@$BIIiEcXDkh}e4z"
        "NTTP_u;xvoAcb+2SBEF}muA*)>=F0m;olCu#cHZZ|28L}=TnXKwCXQt#VNUk(4PN`Cw(x$~ROQ!{~%_*&@+a*aLV=P)9ry<KMZl$U)11"
        "wJ}^rd#KHmaE*#w~B0h_iI3zArtkqb!FW<fl_4RGq*qi71*Oy|NUjyQ)a6&Mp-v3M|ztB{Dm*-!0ZJ*Q~KHq^ZyoL@_X;8!l(DWF%ZJA"
        "(m(_Kd`hbdn%tJo+5)U-L7UR@u?55MJ%*0D=}6rxiFidXRJys53X^dy)eq9GOK+ppDFAgo~^X0VIFg>POH5th$LH}Yb6yW-y_Sh5VMxC"
        "<gyX6#V`ag9-FBy9;G@cd8RV0p{(mM0WvSHF{|CJ@tr&^#HnYfN~L@$A~gFj^)P9tFfeqc8nSJmu&`+>eyOT2CosCAQzu<CBB_b5zON*"
        "$oUFqu_Nd+`=`<{)ey!3VJt&wRKBMs{tfSqi9i|AY-jabWwIk6XoUGKSnW?a-Cb7gN-l`6rZKTSml(J(bFeta4XDRuteJmKNE3nfgNi4"
        "jpb|&&AoT_iGsVvYU<ef_<Z7KjOjVaeGvMMU5{iMmL7bJ(N5+Zvc;iM`pRwNd$a3jW|*sC%qb0GVn(J%NSW-Jt-!YCmokS;SUQy@61Vy"
        "L7n%A=Sk$}SY1yr#q~=Bzxa^DKucVzGcKYbQdazpXf{2Cgfn%d<YJxv`HdDk+tosIvF7{4|WMJF+V^MW$%0l`xGiVz7KKYP0#Mnzd=Oi"
        "62xU%dmg4EiVP4kTCJG3^6sWf3Sb3Brr;`xTRJue6WqGjxiuB9VNUlA~Se0i4LYQaHv-;II*3qZLi`ioh=8bmZ=CN&>T%IjkKjKWT?|G"
        "pP+TGPPD}-)i$uOb1sc50k6%iy)UaPxhyrTaIh+?r7=e_94srUjI4yRbfr?QpR6Y`B&<;{sxghSMI;?3Y_M{%p08l7!X->Jy{hA|RW0J"
        "A>98v_#jH@MGo%wL*sj4Y|FN>G2eJ>bA*_p~7Om~7LNX*S2`qA}Dl$2q#I_Hzt18~CvaTgD{;p}Udp2|<0xZNVXES{^h%CS}<DyEgo2E"
        "vy=B+xh)+0N#7%=~>OfYUO-mv+nuqP=pdnxiV9;>RVKPj)S2CV5VudDX4;WTZgIxA$TCMQL&mN2@l@-r|n6SR1*H?xATrL#XWA1_EHPB"
        "gx&_$!U8s-`8Scc`Zr#wM68J1l*vMJTkX!m4qoi6BiRvnI``#-dv&xFABRsHi3=TBvZDm9eKD;;Hg0ZLCVAJfo(VQL6E%|0$cN4k-7nJ"
        ")d4BaV(&tNv!QByq>ll`5ix<(X7#{E3fh=E1@2=95RQl@D{Bpy{Q{9tSQ|m0x<@#y{IcMa;zGwD73DmOr$iapRQLVn=B|P%`CI3QZ9|0"
        "Mza<wu^JDqZYWc)elPE?2&vDgSuA%mFEW%d5-;8@4vyq0X{tl96{(w{0WEtdOtc>%TPb!dHLQ~)4ybf8XR!vX7O>|lPc^8sX)HZ1;Hlv"
        "&$*6OvWF!r(Cb18ooFB|3FQ)h%d#Hr1f2y&qQ?H^dIxEsJd#Zr3BPu1M;;@afgs(-dEv6?hRWM4bGO(#Fv#~!hc%dU9m9ZhK1F-%pcd;"
        "q0yRJp8M=VYvt}O`;2P_dQQ>_~j7B71yz_UxU6s@PO>94LV;xWFkLN4Yi^(#RzXfRtb)+fy>HLG?hil)x9Kdl0?*`WTVnJIy#EHA&RII"
        "f5>#V@!tGALOrQz)Y-5;DuNqoorqx+&I~xu@tEXeIEcYqJ=zpfOUU%AZUmf~{$=yReI`6R=sKf-rZk&#7Omcq$B}%$|L!>8}2-0wZK0v"
        "95k8EUZPV^dRpnFetMuRV>e__^pa5Cn!az>?I<fD5NeY{jb8U*sgw|v8sHc{4Cj|L@1IehNN1pFfUUW@*npi%ofinIjBe_vm>e`9wdt>"
        "-lSZt8Wr-YC$P`47BD5R>nMXSD;>Ei04$ChC@zn%L8zE7NFLv`P_#EFp{wF4i=3ULKB`qDSs~Ug3oqp(cd!|-E3d4s?x-&&kT998=`I1"
        "SzbZm6qpL18fG$2K1S(=JEGRRs(WQGZ$teINHL#s6fh`27Fe_*#3a;)gJgsr0zNX+V-!-SI0WDgj^{bU2C9+K=PbJ-}eXvoaJ~Fhhwye"
        "b}(Wg|fBOG9!;2}{e_NCJt2&;6nC#JKi6R*3ls;y?MT&(<~J~ERoj3r4kDzG@Lq$#8%2rO@}RxFJy`mnmN0whf$;U@>JyDh;lCarKR1{"
        "LWraW0IkHL(J+3a|RF8Ldhw2Qp`?_Atb(OQZ!ae5vv>P%P`N6R7E}6)pX+CN7+-6|HBc=_d&&cP(12e=iv-J~0z8MJ^68)Gl=_-5G|i!"
        "kV0{Y$l>GoUpm76{rBLIIsw<urWd;EUyYAh>;_!3#e%+jU{6+{H8UWfF$Cn9<7kEFfDK{^{N#mt(iqADJ{4tfGk(3L!)^v@vaOqa<QeX"
        "J1GOGH7rstA+5)$?xr9nbt{G#ud(SZ`WwG0{~~p+;;{ZQ5T?f~<s|bYOds+l1tK=DAt_L%U@lmwGMu`tM5*wy=&O|_9;ZLBI4+MBSuaN"
        "+R<A#;wj?s4fEwtqGN9%wX{@HPnzFwhzpW3g?xvovjV!q(Z=4A!TQLYKMW7U_>KVSP`>Jay_%M;EV65G(04+!`$|d0^fGXOjJ}Lw&-Yl"
        "|}y)W-Dk+Ib#k(`F9%A8uMfG^gs0k4}dTPP5&GA@fQ&M((0RWKnW;;k+#g|F(T->8HwC9uscDlQNz6Q|@PfT}a4TCpuHi7pN-y|5LqMX"
        "On}+NKpQjHx@Yma#gm_Ainow=*>`D6sgZ=&O3Kn<N{qYOoZv2r9Fz+^SNnG9u6{Vy-Hu5hwC48?6s5A}azh;4o(}G_`QBP_Y}LCYz6>2"
        "Q+ppST$0#m8|P9|0SO=0HvO<4k&G?S1jzZK{L~(->oXIx-5ez2Qx{qTrcIUNU{g23@x!QkT5?g46vK1#wd0bY^r@Tb+Ns$8!IU<2(Xbd"
        "q%Q<4Mye|=>zL{oM6NO~h^?M6{;fK!holIypQ-(@HY#-@D5YyKb*Z$l{4iD|B`g)7D==K9WFcEG`Yv24z9R`Fgfn#<fvE(cyD2QF+a=m"
        "4PO##v@2Vav*Q6yaFc_^c!>_<Fg0DR<^^}96{}b)3Mx^{Jp)9v6Ff2Z=0yGRMlCh#KR;DK?o-PM6ADQQ^XdsI)bG2AA{ieVypDcZ{CZ("
        "<}EURiUII-#-wKamL$hL$rOtGb=C$SW`?xLqOw6f_e)vwSlXsoNO0imC%+%T-D#4GQzPbOZn*s7<k^sPBFu&mK3#jX&pJ2dLC;v(HNGc"
        "abYG%#1OhB3`8Su?7gzp|?;A*)g=W}(ol(=76<3Z`!^QZYNS#<F`Zf3RGqsw(0#<s?ijyDhG-imm)D!YslsB{SKuDJ>zb*RdF?RjWp(U"
        "@llM<gu<PLoMnkd#%bYwj3xf`YC*{Jf&YLhB1k;JS#__iJBWFEw9@i{jRsHVW>T+TQ4Q3S+WeS_Nr<s(j>N-sILn#zNtbqEhq`IKBe8R"
        "x~?*?IWtr)udU!L45dt^qBQa%Uau4`1g+aJmYi0z$E-{;5TsD1Tq_bS_NhiGD=wogH7-9RMXWC@cA~$lnV^F-AEY3y&M|>2p(%VX?<`E"
        "M!ZX#cA*x9;SuxqCj3nBm^)MSC4X{6+DkcXkO0i)l?k?+*0<!ih2DEFfhpx1$rmp%N6)aS&!5?(1*)I#9Dl31e8YCO97bRsVlB5|j$0Y"
        "2lJ12Xh?xf6~3bKnANHkHd0V$2C;jSsI&!{7(;vy>)^Q!-uE1zB}CaV4}5iC}$QY^=uJ0&NqEU0Fvg{6M1<*0=f`IYe>uO;fJ@GHBl1f"
        "ndZ1SVc7YpSl0G_BSn$s(;Sa;YtukFM1$JSAJGNTkZBGoG8M-75bgW-l2iwWpG-2`Pi4JTD)n&Y<Bc2C1;4nyD5bHKb}R&z&DD7_4%a!"
        "K6(ob20xV-KbA13?;QGP^ShcZX(8-)F=L&TdOXsM3`VES1N8DdzJL0r78?94J}J74XwJap|wP%?JBaU-KOg%ek%H-9IOheh%D|YI;_g9"
        "rYC5vJFLPg&!s4>3@Gd>7OU5%2QV?T1hOEo(V5~X+%kwM)~Uv*lPs+>E2M~~AGANTrW#={z#gcyJ*+jJ9;`j0d9;--4kApjdn_%MiLxC"
        "uRvo~r5GbanJ226&GpfL@I<0lHTq+eY5vUd;O0u7;sjQDEP$(gv3NSe-2Cy%zeI*kwADWV_8!pYNh7)%#eKP+l0WP>9g(zz(8M0cjF0+"
        ">-)tE&oKdhXfDWrI=nW<-}-=He6hO*iotudXNiK%ui0jSX(&L|(L>nv86i!_$6*RvO;`l<~uj;VR9ZKL+9T_|KVI;CW<=(Xvx0j|d|KP"
        "|zuMyaB)w5y7y(zGfp5->ZZ7qL+-=_@!ft0d#7elD!7%rBFn@~zpayRXuyk0og<5~^R98>sUu>#XghC@2%4hcHMonW^ZXdnZpYHLS0w0"
        ";^*m5iQX%9Wk)7;wYjpU?|@x(<sCzy(}7^Hm8A;grUYDA)zxc5Gr#Re=O}F_#uKSDJSJ6G^pepksL9mvLU~uDKTHHbEOq1O)H=!s}>)j"
        "Auhrq8L5Y*0<N#8$0*kte5QIP4ysrxcC2EmD5`>{>Z3!X10Rm9%cw&wtD$GCI4Rht`6V5mn=DnWk))KKsU?G?JgYFKYOG@^8X3>5@i0a"
        "!JfbNn&a6+Q2C88%c&vM?5~M6EM=doRGOSr9>6Icbm#7Y`m8vuwEG-ABL#(N=AhA;(POmd9s3cu2n-&wJtR;vlhNu^>1F-6-j4so#{V<"
        "!XBCUZhB`<+0YpMk)R4tvFtg#d>S0u=;J|$l*Fd;;$E-VBswJC9}s<ElAOsj@5hAXGEv!<xCjV-h#(6ebOCa`d*8m7Z3A2GWyCnByXT`"
        "Z0zd@|ZC46i7t%&teU0W5tdJ1TZ2jIIZzgQtuylcyJ`G%W(K52VZ}wW!1?F|lK$UL{i?=`gS|{uu<VC?{JnW35CcH?Zoh2C%oRgsl4;t"
        "uXU1gRx?%!7nVUq^|O$Y_Yem=r8-Oi73gU5iqnUvM!sbbuhsoaWD+AzO;xjZ=}zwb1sr5GOQq`cq@}CUNQElZno8~QLC&mXdYX&ldM*>"
        "1tfkk=&!7#S1^|+RJ405k1n(_`L1Oy-6-L!tuePTd$4RTv8-3A0IoPH4imvDgs5VvnXrZ^05VUi$SY5=jjhV9iK4hKfwJAJv8B%{A~jk"
        "wM=)!!C@Bs!fUXL#-KDi7kRY_8|0WqH5UsMO#2i>CvMpRG3$0(Te67fv_$3J+AgwU5y0Anos-;G;daY?L*eLKUH7N-gbt26zc(3=dTqr"
        "XypD+k8F)U6lwkFW5=P3m$d@Fe=b*!VSdnrMrX|0beQ76VL|E^W8@GhXNh^?Nc<so{q-Yo7cRx5HHGptLjOC?z@b)6KjiL1RRTrMFc_9"
        "#vthNnBRiX&{Y!zuBoDxhyI%Pi|KZ!WB=-l9w?t}yE)HL{X0n<`*0FD;XsS}`j!s<nBrZY`aypC}kEFR}}?DW|q152$}I?XcFcc%o1)l"
        "&lxFAG9T)$SDA=C@}RbmMzD%qY;It(JjL?IWh1k$0;x~ji_QL-6$!YtDKH0*R1CmB`n}5wW@Wl&L`w4EhoJof~kkBz^&OTCno5ej-sKQ"
        "h^dOFU7wCE5|_s+u_<G$KeFd7`za)>8?9_2w5#YX5G@5R5vRK$uP<RNk*bZWIIL%`GpY(ILZ@RXA*}_XUaqUAg{5R91E_{5)T1A%0w41"
        "!*eed8Fd^+6o+z&)>!vsr6f6H76)k(H_n|c!H?41>Q>=<BVJo<zb}u5Z1g6HY$0-4(|ENZ;-7mVJL8x6YY9#Ea2p#~d`6!&IRViX5KD0"
        "=%N-?4~*R&F_MKZIt$FLJAEF`lfNwXy}6f0sOAgcf_Ke6ty%`7LS@gxB-4=_70bG4GPwXha4E31(;<F4YPr7uq`thQmUAFG(N`md|4v8"
        "^_zz_hV3s5S#A9JFwpGpPNskS{4Hs~#+@H!9~K6RqK?ucVbFPOxO5MlE|KJh3b>IIyd(x~Fz8j2$W@!mvxB<S#3#My=N{+Oejnl`0Rkd"
        "#1}RBPzZ!8mN=0?xtWfTee9tqA#DU%qWqwAto>`HLzQ+q^TCShO4ZsNUepYWw4|#WG$O4hb>#E1+;#!gAgw$Su=Yu4J`dJ=Ctu6>aGto"
        "B(ip{S{BWmNG)%vA*>Owwy;vO-zA+b_p6<-BCl*M#Wg3Wzo;0hLb3xYw;n?<y|Qhz!Kbw-hpqXmSuQ~$<E)-5DJ-s{2qw`h0kZHY%P_G"
        "j1tkG1K(gs7-kcsZ<1QAoYOb8CnVa6TUNA<l#jSoYVlm*YDyX0@>aYGQ-l%b*Wv>RJk1P(aPn{;Dk|Qv!hOd()N}$T4SSuSP(x)w<mnz"
        "Y$?igASH7UBOgS09ZkEyRJt*788467#@2&i=#Un>A8pC!B~a;l0b@-51%<fcL;7bG&Ee=O)Cc$^xk4684zDliErW+*Qtwkfx)04k-fCo"
        "Fd^45$Ps?4fxtY%cO82eIp-iLh(22(wHm4X|RZ&8&GE%qJo!qNqhLRv>Jl@g~-y&ZN4ea-z^1wk@6}!mbf02^$Qh3M7)SEwWasy&KCNT"
        "BvcN3omiCXRRD8btgC~daNKJIw@2vN~cY*Z7FfBmM~hIS1c0}tt<*C1Gb8(Hnb)oyE0=m8lmT|Win`|H?fQ(?5b9_%B_Gd5~(Vz`Kn>8"
        "vM|pq|E=IHiLi;T=ck37^QJ5@cBnTcdmw}@8!SAf9<3U#E2JN+D;*0hxhz+**DJHBgRm$kOC`4|@GYXKEGJqmJg}IlW~jom#ViUf`zkp"
        "$7%@*BMX7V5$g^;*-6=??L$YeEBP=_s?JZv>A1!9Krza$+DJ*3zF|HP|pD~v$ji@8Egs_;a(JX#3$TKD^HY+@^F10x+O0#Az6QOgeldd"
        "x?uQKwRoR3kc?Hm`i3^2Pd;i6eF;4Nsf#w<uNAu)9*M6K&AO|DNcld3hd6|X%fTPhwf*eHaujid>wLoY2Z7cw?6X)m83qBLf#CacM)f2"
        "B7r8?z-Z?J*-OkFv}t>KuHu5HNbMjIk^eI4}RJ^bp{!k0?>Ef-r@!iKt&MN|cu_+bQ6vBQX@Iov@p%$}7w?Ya?Qw`mbEA2`S_ya4ejrp"
        "f2aJ*r+9_s<FzZrY}6JkD4Vdh%oRn;jS{Vgr=FO3NQz->#7E@&Za}L!K{`jrmwW56EHQZTQFEK4YI^5DKJE@S}jqZN-FFw0V%#R*eLR@"
        "^`_yhS2H-TyRqCZO)2KAnxuN9U$B?27a;yDUMxSVMzAq8N2VXLc`ZXI1~P@PnXWP>9I%w9LNB{7NU!6qUNDoffGtWe60?dhSClWb88EL"
        "jEU-+kqAAce@-j`cSg=#3!Z3@kw5*jXWG<+-*DM{YOtJ7N(lQGziLwH$+oD9T3oy~LDX-u#qcu0P95F$yn6ND>NHIAx5V3ojx0@%U#-%"
        "ZyDWtobU7(Dho+tVw^Q#r5MJ8M&KB+z=Z>u(??50Mj3N56j)d0_-f+G$kBq~NGW21i;j-+UvmZ=^oww*C1L#St+6BNiFtfs;z^Bf7KCn"
        "5hGAtuKrrV}SA|0J@a|D|Un)*c@zwW_-!=r4yP6bzB5s-nuMEsz`_-X-FUmZ>qJVy-wMFsQvK9~-tBy`u~+3!*_Gld1ZoN2m%aJ1gxXf"
        "v0+(@+`?LY@mxL)vCy-Jt@SY*r-CKzbtw!oUecoJE-QUswH44_@w<RQmDl$NGzx(iY5xE^d?CWBPv29UMMA|eWe?#R;1}7q$trPk|YGE"
        "dn}nJcq=lkswyWe{w!RiO{vbNS*he7Qze=mb0%;rsHKXbY?bqg-K&PCX)G=#nWjr9Wh9?2Y9jv(U7YSJ6Cm-b5+?{Kcq`;BtuJt-=_m="
        "E&7=V-TAcE+?5<WIB`r9j<t$_<MK0j20;ZIx2&}fLqolqqH83hIPOO2bo2n2mEh<qlks*$#(jD8CYAKMg93H?hwknh<RjGWgps3a-s4X"
        "3(Hmz|mK_mPtD<(-Mg)hx3)hQsfx2lP-)Ucf^)2tLP-=MrERj;xz&M$eaW-te+_ANRre<jtZk*Fgu%B+L1Yc{U0(<i?yS0QOB+Nc_=R<"
        "q44)vshPPbxSkr7sb$*(@3@b}h^qD;z^6(j^)v?;{o|d99i=AhLxl2{EuR7O*ImU8ov1;HWjPOQn@5%P~_a&nXS83aP83UM*@Zdaz<O9"
        "kEy@$}YmN7_3Gt*(lSfousKI8LXu#@h6chKAYPlB`7s6xgqH+i5~ngO{~|i6RbcQSF&0x6QcvE&@6>5ZLiy;Q8JOLFD-DajjS9m6)lV;"
        "Eh(#@^Q?KTBd$xeGc?4hQLwZyS2RAZu&awH&@6A24=CBEcrZG!e6Cfg39ApSO)ah{zbtF8eJqBpVK3gRD=@<(S}AU*rYl3TsxG@Nj<JN"
        "51}?EM(Jbh$F|zKgj;L#?dMm6f_OT~2ku01nvZ>=J6fXFzhA15*X{=MQo+`wo^C9pe`Yi`BFB`w703*CCp(brCg|M?OwkBI7Tdh4Lg{c"
        "`RSgsf;3otRGkE^vN=bfM_ORYDmdn`M!AFdB8VywuXFsJpgofK`Z7cbDQi!S*p94r8@Ff*(vIH(UP@GQ8k0kFp>k*P7FyewC%lqX290W"
        "Dpnn5aFkW-4*4w3QT{E-(zQu_hWV%PE|!ajpuZT%=+scB#u9S}SC-ma>1bp02C0Ca_B_s3=P=^|4H^6Q;r^QY*kIKd*kV1hkzne<we(a"
        "UwIWswojJO0q31FsAplVX6ix5HoVDS}&QdB`onI$sHQ3ydgaw#3mpt*{0~Oswmy0m!}1-QmQVM|E+~B6dH`87qM3)p`R(LBPG@*H?Y^H"
        "v9u8-&Y{<=X(;wE)}tvSCnZHN8ZBb0ZLo*14yMVj3b7opRjQA#Dl9TEX)1gu*Qa$X?4;==Ca$ihl&w*%87AJLR4YuJpQxiQqM{Eal&il"
        "L)UOewy)8SWCa{*M{VMFSjjC=Upf2<;k1md<cPcwB|Ddv+R2t&2S*|afD6*~%zN1sDhb$ee&ZPY*E-CadaxMTFhcI}sC@O`ilpap6N;B"
        "Uou%B6~6(P7SY^>)Yprr~et*OSJC?p-OQL9oMAf_6x*%h@cy0FzCM<{M1*r^pS8?2oy>@6Rv?X1};-JzPOzA3}5@FOHE@tjww_AIt5<t"
        "P?1E)^~<lrJ!_xhXd$1u`k8Zzmcn(W-GA8>wBZ5Gq?Pqb&fin=Oj0yeFq9A0fl7Rj$S*$}K!4JFEk<wWnh$cP-f>b1;k~%C9ym-7YjRu"
        "&E?5k16=7K_s9dg`={p<)2WkS1_NHH!VIY=cs)$n5yrn;i}=P=`6-Ac%)__L$m8F#<1)qzcH6A6DVdeksrFKMKIZ{Z6l!|L#gH=1Fm-`"
        "PqhN75v+_P3@D8+fvugd1vDu#ktBts`7VN`7n>R^!6oXmQmkz#dnjF@Fdc9&C$43zi>NB1*{#ti_pAn$%_>u^!>`*YATDwxw5yh|B`ic"
        "NE*<f*5v*aSPNw)RgcpCOPPC@2t0mVdlr7gM-Wc$q0W_H~z@N{kKd_#ti8jnW*0#Yq;IV}?$}lS@!8AHG6ENPaMKj7Y<F&y#iZvBBb+?"
        "$Xw7iTl8MT2n`Y`vpmM|SRuQ+cuM6^q}1;4JgE<C?BI<!|i;4nupsJ5c1J+~7z95d6lim|pi",
    ),
    (
        48,
        8,
        "&o(YEzBWj>;In78STSTSC^y<S5wWSSXSdum`=DdEx->7f5w+T|12-wTfjP}6L9^5<Qncnd38}X(4J*^Nzp#I{<gIKq@v^BXQ?+3_3pMe"
        "p*ftR-j4g^dA-q|&*tp#>kt_nM`?BG*z&6=8RylI8x2Th?_p@BEH?v?dIym1i5U8Lrj;o?J|G9UzizNlP5x5?*U9wd#NH{q<*0}IC^)&"
        "ykQ?8P*urzxa$hSPS?l!<SZ?LNv-KttIf2=AkC^1AZJ*}^>>bM9vc{M_}<FatHrLoO4VW#;vmMxaJfGIYzK`Hb)ys@6E46&;%vpE*D1F"
        "(xV@3;7=LpLxqGPtI&^{{xei7oOmbv4;AmO0_AqqGLJ2C*WwWwkiA2_y@zh^bGld^)@_**OKZc_$Ju3$&83g(#u2LOLV0rY5Q_Z?82t@"
        "3}&<rZHa;;j&dVSebUYy*1Y?Dz^0`mb3CS4Y5!+6|XohgS449@-rkc!<=$3Y_|fmfwj)HIJNJr53~|E!8UX^P?Mu9Q@H>)53l$!VXYf4"
        "k~w;|;WgJNMYM>m0<__*lQue=POYODcR4Dw1hXo*&o^eV^|=MCo3)`g#4krPL@^#Sld{yc$}ViPtvT_vpf`oJD7G;u@2uc3dpEbVa;5b"
        "y>@eaxsJ4QgG`5?z9X$BBDL3|=*`3NZcDtgs;<T-_*0`IfiZDYuWHA#lBeHm^yfI0z6*r)`Ag~5E!m+G3hOue2!mD+%I3S@mgt9rWP_!"
        ";C@v|S9PLeY^6e%z`Z#Jc=A-FR&khOZXFfPltgtf#rm9GV~<~SHFPqdk`46&xM`XtXTOs)w!QaJ{=crqTPnyG0x6}h;w;ki;TwI-3P3$"
        "(eiaXVx&oG_FzqAV)42eBWvhN^cs-Y^=l6EQ`r3%1g?eK>nE0xm(Y7qrwl7_^47gS5{yC^LGvh&UXwr?AI5c)0noceZdjHZ|t3@GT^?O"
        "s=)Cw75pLBQT>aj5ql-KQY^{g(a3eYBt5bsx_msT`ax4",
    ),
)
